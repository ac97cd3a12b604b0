/* PX4's own unit tests of uORB, by their names and in their order, and what they
 * check: systemcmds/uorb_tests, and the gtest of subscriptions.
 *
 * They differ in two things. Where PX4's sleep for a while, these wait for each
 * other. And a node's generation cannot be set from outside: the broker starts
 * nodes of orb_test_medium_wrap_around Q / 2 before the wrap, so each part of
 * that test takes a node of its own. */

#include <math.h>

#include <atomic>
#include <thread>

#include <drivers/drv_hrt.h>
#include <px4_platform_common/posix.h>

#include <uORB/Publication.hpp>
#include <uORB/PublicationMulti.hpp>
#include <uORB/Subscription.hpp>
#include <uORB/SubscriptionMultiArray.hpp>
#include <uORB/topics/orb_test.h>
#include <uORB/topics/orb_test_medium.h>

#include "check.h"

static orb_advert_t _pfd[4];

static bool check(int handle)
{
	bool updated = true;
	CHECK_EQUAL(orb_check(handle, &updated), PX4_OK);
	return updated;
}

template<typename T>
static int copy(const orb_metadata *meta, int handle)
{
	T message{};
	message.val = -1;
	CHECK_EQUAL(orb_copy(meta, handle, &message), PX4_OK);
	return message.val;
}

template<typename T>
static void publish(const orb_metadata *meta, orb_advert_t handle, int val)
{
	T message{};
	message.timestamp = hrt_absolute_time();
	message.val = val;
	CHECK_EQUAL(orb_publish(meta, handle, &message), PX4_OK);
}

static void test_single()
{
	orb_test_s t{};
	orb_advert_t ptopic = orb_advertise(ORB_ID(orb_test), &t);
	CHECK(ptopic != nullptr);

	const int sfd = orb_subscribe(ORB_ID(orb_test));
	CHECK(sfd >= 0);
	CHECK_EQUAL(copy<orb_test_s>(ORB_ID(orb_test), sfd), 0);
	CHECK(!check(sfd));

	publish<orb_test_s>(ORB_ID(orb_test), ptopic, 2);
	CHECK(check(sfd));
	CHECK_EQUAL(copy<orb_test_s>(ORB_ID(orb_test), sfd), 2);

	CHECK_EQUAL(orb_unsubscribe(sfd), PX4_OK);
	CHECK_EQUAL(orb_unadvertise(ptopic), PX4_OK);
}

static void test_SubscriptionMulti()
{
	uORB::PublicationMulti<orb_test_s> pubs[ORB_MULTI_MAX_INSTANCES] {
		ORB_ID::orb_test, ORB_ID::orb_test, ORB_ID::orb_test, ORB_ID::orb_test, ORB_ID::orb_test,
		ORB_ID::orb_test, ORB_ID::orb_test, ORB_ID::orb_test, ORB_ID::orb_test, ORB_ID::orb_test,
	};
	uORB::SubscriptionMultiArray<orb_test_s> subs{ORB_ID::orb_test};

	// test_single has unadvertised its instance.
	for (auto &sub : subs) {
		CHECK(!sub.advertised());
	}

	for (int i = 0; i < ORB_MULTI_MAX_INSTANCES; i++) {
		CHECK(pubs[i].advertise());
		CHECK(subs[i].advertised());
		CHECK_EQUAL(subs.advertised_count(), i + 1);
		CHECK_EQUAL(subs[i].get_instance(), i);
		CHECK_EQUAL(pubs[i].get_instance(), i);
	}

	// What test_single has published is new to who subscribes.
	orb_test_s message{};
	CHECK(subs[0].update(&message));
	CHECK(!subs.updated());

	for (int t = 0; t < 2; t++) {
		for (int i = 0; i < 10; i++) {
			for (int instance = 0; instance < ORB_MULTI_MAX_INSTANCES; instance++) {
				message.timestamp = hrt_absolute_time();
				message.val = i * instance + t;
				CHECK(pubs[instance].publish(message));
			}

			int instance = 0;

			for (auto &sub : subs) {
				CHECK(sub.updated());
				const unsigned last_generation = sub.get_last_generation();
				CHECK(sub.copy(&message));
				CHECK_EQUAL(message.val, i * instance + t);
				CHECK_EQUAL(sub.get_last_generation(), last_generation + 1);
				instance++;
			}
		}

		// Who subscribes again sees the newest message as an update.
		for (auto &sub : subs) {
			sub.unsubscribe();
			CHECK(sub.update(&message));
		}
	}
}

static int latency_test(int runs);

static void test_multi()
{
	orb_test_s t{};
	int instance0 = -1;
	int instance1 = -1;
	// The priorities are of PX4 to 2020.
	_pfd[0] = orb_advertise_multi(ORB_ID(orb_multitest), &t, &instance0, ORB_PRIO_MAX);
	_pfd[1] = orb_advertise_multi(ORB_ID(orb_multitest), &t, &instance1, ORB_PRIO_MIN);
	CHECK(_pfd[0] != nullptr && _pfd[1] != nullptr);
	CHECK_EQUAL(instance0, 0);
	CHECK_EQUAL(instance1, 1);

	publish<orb_test_s>(ORB_ID(orb_multitest), _pfd[0], 103);
	publish<orb_test_s>(ORB_ID(orb_multitest), _pfd[1], 203);

	const int sfd0 = orb_subscribe_multi(ORB_ID(orb_multitest), 0);
	CHECK_EQUAL(copy<orb_test_s>(ORB_ID(orb_multitest), sfd0), 103);
	const int sfd1 = orb_subscribe_multi(ORB_ID(orb_multitest), 1);
	CHECK_EQUAL(copy<orb_test_s>(ORB_ID(orb_multitest), sfd1), 203);

	int priority = 0;
	CHECK_EQUAL(orb_priority(sfd0, &priority), PX4_OK);
	CHECK_EQUAL(priority, ORB_PRIO_MAX);
	CHECK_EQUAL(orb_priority(sfd1, &priority), PX4_OK);
	CHECK_EQUAL(priority, ORB_PRIO_MIN);

	CHECK_EQUAL(latency_test(50), PX4_OK);
	CHECK_EQUAL(orb_unsubscribe(sfd0), PX4_OK);
	CHECK_EQUAL(orb_unsubscribe(sfd1), PX4_OK);
}

static void test_multi_reversed()
{
	// Instances 0 and 1 are taken from before.
	const int sfd2 = orb_subscribe_multi(ORB_ID(orb_multitest), 2);
	CHECK(sfd2 >= 0);

	orb_test_s t{};
	int instance2 = -1;
	int instance3 = -1;
	_pfd[2] = orb_advertise_multi(ORB_ID(orb_multitest), &t, &instance2);
	_pfd[3] = orb_advertise_multi(ORB_ID(orb_multitest), &t, &instance3);
	CHECK_EQUAL(instance2, 2);
	CHECK_EQUAL(instance3, 3);

	publish<orb_test_s>(ORB_ID(orb_multitest), _pfd[2], 204);
	publish<orb_test_s>(ORB_ID(orb_multitest), _pfd[3], 304);

	CHECK_EQUAL(copy<orb_test_s>(ORB_ID(orb_multitest), sfd2), 204);
	const int sfd3 = orb_subscribe_multi(ORB_ID(orb_multitest), 3);
	CHECK_EQUAL(copy<orb_test_s>(ORB_ID(orb_multitest), sfd3), 304);
	CHECK_EQUAL(orb_unsubscribe(sfd2), PX4_OK);
	CHECK_EQUAL(orb_unsubscribe(sfd3), PX4_OK);
}

static void test_unadvertise()
{
	for (int i = 0; i < 4; i++) {
		CHECK_EQUAL(orb_unadvertise(_pfd[i]), PX4_OK);
	}

	orb_test_s t{};

	for (int i = 0; i < 4; i++) {
		int instance = -1;
		_pfd[i] = orb_advertise_multi(ORB_ID(orb_multitest), &t, &instance);
		CHECK_EQUAL(instance, i);
	}

	for (int i = 0; i < 4; i++) {
		CHECK_EQUAL(orb_unadvertise(_pfd[i]), PX4_OK);
	}
}

static void test_multi2()
{
	constexpr int INSTANCES = 3;
	constexpr int MESSAGES = 50 * INSTANCES;
	const orb_metadata *meta = ORB_ID(orb_test_medium_multi);
	int subs[INSTANCES];

	for (int i = 0; i < INSTANCES; i++) {
		subs[i] = orb_subscribe_multi(meta, i);
		CHECK(subs[i] >= 0);
	}

	std::atomic<int> copied{0};

	std::thread publisher{[&] {
		orb_advert_t pubs[INSTANCES];
		orb_test_medium_s message{};

		for (int i = 0; i < INSTANCES; i++) {
			int instance = -1;
			pubs[i] = orb_advertise_multi(meta, nullptr, &instance);
			CHECK_EQUAL(instance, i);
		}

		for (int number = 0; number < MESSAGES; number++) {
			// A round ahead of the reader, no more.
			while (number - copied >= INSTANCES) {
				std::this_thread::yield();
			}

			// Timestamps have to differ.
			for (const hrt_abstime last = message.timestamp; message.timestamp == last;) {
				message.timestamp = hrt_absolute_time();
			}

			message.val = number % INSTANCES;
			CHECK_EQUAL(orb_publish(meta, pubs[number % INSTANCES], &message), PX4_OK);
		}

		for (auto &pub : pubs) {
			CHECK_EQUAL(orb_unadvertise(pub), PX4_OK);
		}
	}};

	hrt_abstime last_time = 0;

	for (int number = 0; number < MESSAGES; number++) {
		px4_pollfd_struct_t fd{subs[number % INSTANCES], POLLIN, 0};
		CHECK_EQUAL(px4_poll(&fd, 1, PATIENCE_MS), 1);
		orb_test_medium_s message{};
		CHECK_EQUAL(orb_copy(meta, fd.fd, &message), PX4_OK);
		CHECK_EQUAL(message.val, number % INSTANCES);
		CHECK(message.timestamp > last_time);
		last_time = message.timestamp;
		copied++;
	}

	publisher.join();

	for (int sub : subs) {
		CHECK_EQUAL(orb_unsubscribe(sub), PX4_OK);
	}
}

/** A publication and a subscription of one node that keeps Q messages. */
struct Queue {
	const orb_metadata *meta;
	orb_advert_t pub;
	int sub;
	int length;

	void write(int val) const { publish<orb_test_medium_s>(meta, pub, val); }

	void reads_update(int val) const
	{
		CHECK(check(sub));
		CHECK_EQUAL(copy<orb_test_medium_s>(meta, sub), val);
	}

	void is_not_updated() const { CHECK(!check(sub)); }

	void fill() const
	{
		for (int i = 0; i < length - 2; i++) {
			write(i);
		}

		for (int i = 0; i < length - 2; i++) {
			reads_update(i);
		}

		is_not_updated();
	}

	void overflow() const
	{
		constexpr int OVERFLOW_BY = 3;

		for (int i = 0; i < length + OVERFLOW_BY; i++) {
			write(i);
		}

		for (int i = 0; i < length; i++) {
			reads_update(i + OVERFLOW_BY);
		}

		is_not_updated();
	}

	void underflow() const
	{
		write(length);
		reads_update(length);

		for (int i = 0; i < length; i++) {
			is_not_updated();
			CHECK_EQUAL(copy<orb_test_medium_s>(meta, sub), length);
		}

		write(943);
		reads_update(943);
	}
};

static void test_wrap_around()
{
	const orb_metadata *meta = ORB_ID(orb_test_medium_wrap_around);
	orb_advert_t pubs[3];

	for (int part = 0; part < 3; part++) {
		int instance = -1;
		pubs[part] = orb_advertise_multi(meta, nullptr, &instance);
		CHECK_EQUAL(instance, part);
		const Queue queue{meta, pubs[part], orb_subscribe_multi(meta, part), orb_get_queue_size(meta)};
		CHECK_EQUAL(queue.length, 16);
		queue.is_not_updated();

		// The same instance with a generation to look at.
		uORB::Subscription watch{meta, static_cast<uint8_t>(part)};
		orb_test_medium_s message{};
		queue.write(0);
		CHECK(watch.copy(&message));
		const unsigned before = watch.get_last_generation();
		CHECK_EQUAL(before, 0u - queue.length / 2 + 1);
		queue.reads_update(0);
		queue.is_not_updated();

		switch (part) {
		case 0:
			queue.fill();
			break;

		case 1:
			queue.overflow();
			break;

		case 2:
			// Up to the last one before the wrap.
			for (int i = 2; i < queue.length / 2; i++) {
				queue.write(i);
				queue.reads_update(i);
			}

			queue.underflow();
			break;
		}

		while (watch.update(&message)) {}

		CHECK(watch.get_last_generation() < before);
		CHECK_EQUAL(orb_unsubscribe(queue.sub), PX4_OK);
	}

	for (auto &pub : pubs) {
		CHECK_EQUAL(orb_unadvertise(pub), PX4_OK);
	}
}

static void test_queue()
{
	const orb_metadata *meta = ORB_ID(orb_test_medium_queue);
	Queue queue{meta, nullptr, orb_subscribe(meta), 16};
	CHECK(queue.sub >= 0);
	orb_test_medium_s t{};
	queue.pub = orb_advertise_queue(meta, &t, 16);
	CHECK(queue.pub != nullptr);
	queue.reads_update(0);
	queue.is_not_updated();

	queue.fill();
	queue.overflow();
	queue.underflow();

	CHECK_EQUAL(orb_unadvertise(queue.pub), PX4_OK);
	CHECK_EQUAL(orb_unsubscribe(queue.sub), PX4_OK);
}

static void test_queue_poll_notify()
{
	const orb_metadata *meta = ORB_ID(orb_test_medium_queue_poll);
	constexpr int LENGTH = 16;
	constexpr int MESSAGES = 20 * LENGTH;
	const int sub = orb_subscribe(meta);
	CHECK(sub >= 0);
	std::atomic<int> copied{0};

	std::thread publisher{[&] {
		orb_test_medium_s t{};
		const orb_advert_t pub = orb_advertise_queue(meta, &t, LENGTH);
		CHECK(pub != nullptr);

		for (int sent = 1; sent < MESSAGES;) {
			// The queue is empty: a burst fits.
			while (copied < sent) {
				std::this_thread::yield();
			}

			for (int burst = 0; burst < LENGTH / 2 + 7 && sent < MESSAGES; burst++) {
				publish<orb_test_medium_s>(meta, pub, sent++);
			}
		}

		CHECK_EQUAL(orb_unadvertise(pub), PX4_OK);
	}};

	// One copy a wake, and every message comes.
	while (copied < MESSAGES) {
		px4_pollfd_struct_t fd{sub, POLLIN, 0};
		CHECK_EQUAL(px4_poll(&fd, 1, PATIENCE_MS), 1);
		CHECK(fd.revents & POLLIN);
		CHECK_EQUAL(copy<orb_test_medium_s>(meta, sub), copied);
		copied++;
	}

	publisher.join();
	CHECK(!check(sub));
	CHECK_EQUAL(orb_unsubscribe(sub), PX4_OK);
}

/** Prints; how long a wake takes is not for a test to judge. */
static int latency_test(int runs)
{
	const orb_metadata *meta = ORB_ID(orb_test_medium);
	const int sub = orb_subscribe(meta);
	std::atomic<bool> should_exit{false};

	std::thread publisher{[&] {
		static orb_test_medium_s t{};
		const orb_advert_t pub = orb_advertise(meta, nullptr);

		while (!should_exit) {
			t.val++;
			t.timestamp = hrt_absolute_time();
			CHECK_EQUAL(orb_publish(meta, pub, &t), PX4_OK);
			// What is measured is how soon the sleeper wakes, so it has to sleep.
			px4_usleep(1000);
		}

		CHECK_EQUAL(orb_unadvertise(pub), PX4_OK);
	}};

	double sum = 0.0;
	double sum_of_squares = 0.0;
	hrt_abstime min = UINT64_MAX;
	hrt_abstime max = 0;
	int missed = 0;
	int last = -1;
	// What is from before says nothing about now.
	orb_copy(meta, sub, nullptr);

	for (int i = 0; i < runs; i++) {
		px4_pollfd_struct_t fd{sub, POLLIN, 0};
		CHECK_EQUAL(px4_poll(&fd, 1, PATIENCE_MS), 1);
		orb_test_medium_s t{};
		CHECK_EQUAL(orb_copy(meta, sub, &t), PX4_OK);
		const hrt_abstime latency = hrt_elapsed_time(&t.timestamp);
		sum += latency;
		sum_of_squares += static_cast<double>(latency) * latency;
		min = latency < min ? latency : min;
		max = latency > max ? latency : max;
		missed += last < 0 ? 0 : t.val - last - 1;
		last = t.val;
	}

	should_exit = true;
	publisher.join();
	const double mean = sum / runs;
	PX4_INFO("mean:    %8.4f us", mean);
	PX4_INFO("std dev: %8.4f us", sqrt(sum_of_squares / runs - mean * mean));
	PX4_INFO("min:     %3" PRIu64 " us", min);
	PX4_INFO("max:     %3" PRIu64 " us", max);
	PX4_INFO("missed topic updates: %i", missed);
	return orb_unsubscribe(sub);
}

static void latency_test()
{
	CHECK_EQUAL(latency_test(200), PX4_OK);
}

/** Wished for in PX4's pull request 16084. */
static void test_single_unadvertise()
{
	const orb_metadata *meta = ORB_ID(orb_test);
	const orb_advert_t stays = orb_advertise(meta, nullptr);
	const orb_advert_t goes = orb_advertise(meta, nullptr);
	const int sub = orb_subscribe(meta);
	publish<orb_test_s>(meta, goes, 1);
	CHECK_EQUAL(orb_unadvertise(goes), PX4_OK);

	CHECK_EQUAL(orb_exists(meta, 0), PX4_OK);
	CHECK_EQUAL(copy<orb_test_s>(meta, sub), 1);
	publish<orb_test_s>(meta, stays, 2);
	CHECK(check(sub));
	CHECK_EQUAL(copy<orb_test_s>(meta, sub), 2);

	CHECK_EQUAL(orb_unadvertise(stays), PX4_OK);
	CHECK_EQUAL(orb_exists(meta, 0), PX4_ERROR);
	CHECK_EQUAL(orb_unsubscribe(sub), PX4_OK);
}

/** PX4's gtest of uORB::Subscription. */
static void updated_subscribes()
{
	uORB::Publication<orb_test_medium_s> medium{ORB_ID(orb_test_medium)};
	CHECK(medium.advertise());
	uORB::Subscription sub{ORB_ID::orb_test_medium};
	sub.unsubscribe();
	CHECK(!sub.valid());

	sub.updated();
	CHECK(sub.valid());

	// Who subscribed anew would see the newest message as new.
	orb_test_medium_s message{};
	CHECK(medium.publish(message));

	while (sub.update(&message)) {}

	CHECK(!sub.updated());
	CHECK(sub.valid());
}

struct Test {
	const char *name;
	void (*run)();
};

static const Test TESTS[] = {
	{"test_single", test_single},
	{"test_SubscriptionMulti", test_SubscriptionMulti},
	{"test_multi", test_multi},
	{"test_multi_reversed", test_multi_reversed},
	{"test_unadvertise", test_unadvertise},
	{"test_multi2", test_multi2},
	{"test_wrap_around", test_wrap_around},
	{"test_queue", test_queue},
	{"test_queue_poll_notify", test_queue_poll_notify},
	{"latency_test", latency_test},
	{"test_single_unadvertise", test_single_unadvertise},
	{"updated_subscribes", updated_subscribes},
};

int main()
{
	for (const Test &test : TESTS) {
		test.run();
		printf("PASS %s\n", test.name);
	}

	return 0;
}
