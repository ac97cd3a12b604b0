/* The C++ classes: every method, and what is surprising about each. */

#include <atomic>
#include <thread>
#include <type_traits>

#include <drivers/drv_hrt.h>

#include <uORB/Publication.hpp>
#include <uORB/PublicationMulti.hpp>
#include <uORB/Subscription.hpp>
#include <uORB/SubscriptionBlocking.hpp>
#include <uORB/SubscriptionCallback.hpp>
#include <uORB/SubscriptionInterval.hpp>
#include <uORB/SubscriptionMultiArray.hpp>
#include <uORB/topics/orb_test.h>
#include <uORB/topics/orb_test_medium.h>

#include "check.h"

// Each test has a topic of its own, which is defined in code and has no id.
struct number_s {
	int n;
};
#define TOPIC(_name) \
	ORB_DECLARE(_name); \
	ORB_DEFINE(_name, number_s)

// Under valgrind threads take turns, and a few rounds take long.
#ifdef FEWER
constexpr int ROUNDS = 200;
#else
constexpr int ROUNDS = 5000;
#endif

static int copied(uORB::Subscription &sub)
{
	number_s message{-1};
	CHECK(sub.copy(&message));
	return message.n;
}

// By language: a pointer in C++, of a word's size, and no more than a number.
static_assert(std::is_pointer<orb_advert_t>::value, "orb_advert_t is a pointer in C++");

TOPIC(pointers);

static void a_publication_is_a_pointer()
{
	orb_advert_t none = orb_advertise(nullptr, nullptr);
	CHECK(none == nullptr);
	CHECK_FAILS(orb_unadvertise(none), -1, EINVAL);
	const number_s message{1};
	CHECK_FAILS(orb_publish(ORB_ID(pointers), none, &message), -1, EFAULT);

	int instance = -1;
	CHECK_EQUAL(orb_publish_auto(ORB_ID(pointers), &none, &message, &instance), 0);
	CHECK(none != nullptr);
	CHECK_EQUAL(instance, 0);
	CHECK_EQUAL(orb_get_instance(none), 0);
	CHECK_EQUAL(orb_publish(ORB_ID(pointers), none, &message), 0);
	CHECK_EQUAL(orb_unadvertise(none), 0);
	CHECK_FAILS(orb_publish(ORB_ID(pointers), none, &message), -1, EBADF);
}

TOPIC(published);

static void a_publication_advertises_when_it_first_publishes()
{
	uORB::Subscription sub{ORB_ID(published)};
	{
		uORB::Publication<number_s> pub{ORB_ID(published)};
		CHECK(!pub.advertised());
		CHECK(pub.get_topic() == ORB_ID(published));
		CHECK(!sub.advertised());
		CHECK(pub.publish(number_s{1}));
		CHECK(pub.advertised() && sub.advertised());
		CHECK(pub.advertise());

		// A copy is another publisher of the topic, not of the handle.
		uORB::Publication<number_s> other{pub};
		CHECK(!other.advertised());
		CHECK(other.publish(number_s{2}));
		CHECK_EQUAL(copied(sub), 2);

		CHECK(pub.unadvertise());
		CHECK(!pub.advertised());
		CHECK(!pub.unadvertise());
		CHECK(sub.advertised());
		CHECK(pub.publish(number_s{3}));
	}
	// Both have gone, and the last message is there.
	CHECK(!sub.advertised());
	CHECK(sub.updated());
	CHECK_EQUAL(copied(sub), 3);
	CHECK(!sub.updated());
}

static void a_publication_of_a_queue_stays_advertised()
{
	// Who commands and goes leaves the command behind.
	CHECK_EQUAL((uORB::DefaultQueueSize<orb_test_medium_s>::value), 16);
	CHECK_EQUAL((uORB::DefaultQueueSize<number_s>::value), 1);
	uORB::Subscription sub{ORB_ID::orb_test_medium};
	{
		uORB::Publication<orb_test_medium_s> pub{ORB_ID::orb_test_medium};
		orb_test_medium_s message{};

		for (message.val = 0; message.val < 5; message.val++) {
			CHECK(pub.publish(message));
		}
	}
	CHECK(sub.advertised());
}

TOPIC(deepened);

static void a_publication_may_ask_for_a_queue()
{
	uORB::Publication<number_s, 4> pub{ORB_ID(deepened)};
	CHECK(pub.advertise());
	uORB::Subscription sub{ORB_ID(deepened)};

	for (int n = 0; n < 6; n++) {
		CHECK(pub.publish(number_s{n}));
	}

	number_s message{};

	for (int n = 2; n < 6; n++) {
		CHECK(sub.update(&message));
		CHECK_EQUAL(message.n, n);
	}

	CHECK(!sub.update(&message));
}

TOPIC(with_data);

static void publications_and_subscriptions_may_have_their_message_within()
{
	uORB::SubscriptionData<number_s> early{ORB_ID(with_data)};
	CHECK_EQUAL(early.get().n, 0);
	CHECK(!early.update());

	uORB::PublicationData<number_s> pub{ORB_ID(with_data)};
	pub.get().n = 1;
	CHECK(pub.update());
	CHECK(early.update());
	CHECK_EQUAL(early.get().n, 1);
	pub.set(number_s{2});
	CHECK(pub.update());
	CHECK(pub.update(number_s{3}));
	CHECK_EQUAL(pub.get().n, 3);

	// What was there before is no update.
	uORB::SubscriptionData<number_s> late{ORB_ID(with_data), 0};
	CHECK_EQUAL(late.get().n, 3);
	CHECK(!late.updated());
	CHECK(!late.update());

	uORB::PublicationMultiData<number_s> second{ORB_ID(with_data)};
	second.get().n = 10;
	CHECK(second.update());
	second.set(number_s{11});
	CHECK(second.update(number_s{12}));
	CHECK_EQUAL(second.get_instance(), 1);
	uORB::SubscriptionData<number_s> of_second{ORB_ID(with_data), 1};
	CHECK_EQUAL(of_second.get().n, 12);

	// By number, of topics that have one.
	uORB::PublicationData<orb_test_s> by_number{ORB_ID::orb_test};
	uORB::PublicationMultiData<orb_test_s> multi_by_number{ORB_ID::orb_multitest};
	CHECK(by_number.update() && multi_by_number.update());
	uORB::SubscriptionData<orb_test_s> data{ORB_ID::orb_test};
	CHECK(data.valid());
}

TOPIC(instances);

static void publications_of_instances_claim_the_lowest()
{
	uORB::PublicationMulti<number_s> first{ORB_ID(instances)};
	uORB::PublicationMulti<number_s> second{ORB_ID(instances)};
	// To ask for it is to claim it, in the order of asking.
	CHECK_EQUAL(second.get_instance(), 0);
	CHECK(second.advertised());
	CHECK(first.publish(number_s{1}));
	CHECK_EQUAL(first.get_instance(), 1);

	uORB::PublicationMulti<number_s> others[8] {
		ORB_ID(instances), ORB_ID(instances), ORB_ID(instances), ORB_ID(instances),
		ORB_ID(instances), ORB_ID(instances), ORB_ID(instances), ORB_ID(instances),
	};

	for (int i = 0; i < 8; i++) {
		CHECK_EQUAL(others[i].get_instance(), i + 2);
	}

	uORB::PublicationMulti<number_s> one_too_many{ORB_ID(instances)};
	CHECK_EQUAL(one_too_many.get_instance(), -1);
	CHECK(!one_too_many.advertise());
	CHECK(!one_too_many.publish(number_s{1}));
	CHECK(others[3].unadvertise());
	CHECK_EQUAL(one_too_many.get_instance(), 5);
}

TOPIC(followed);

static void a_subscription_looks_for_its_node_at_every_call()
{
	number_s message{};
	uORB::Subscription sub{ORB_ID(followed)};
	CHECK(!sub.valid());
	CHECK(!sub.subscribe());
	CHECK(!sub.advertised() && !sub.updated() && !sub.update(&message) && !sub.copy(&message));
	CHECK_EQUAL(sub.get_last_generation(), 0);
	// It does not make the node.
	CHECK_EQUAL(orb_group_count(ORB_ID(followed)), 0);

	uORB::Publication<number_s> pub{ORB_ID(followed)};
	CHECK(pub.advertise());
	CHECK(sub.advertised());
	CHECK(sub.valid());
	CHECK(!sub.updated() && !sub.copy(&message));
	CHECK(pub.publish(number_s{1}));
	CHECK(sub.updated());
	CHECK(sub.update(&message));
	CHECK_EQUAL(message.n, 1);
	CHECK(!sub.update(&message));
	CHECK(sub.copy(&message));

	// Two generations on, one message was lost.
	const unsigned generation = sub.get_last_generation();
	CHECK(pub.publish(number_s{2}) && pub.publish(number_s{3}));
	CHECK_EQUAL(copied(sub), 3);
	CHECK_EQUAL(sub.get_last_generation() - generation, 2);

	sub.unsubscribe();
	CHECK(!sub.valid());
	CHECK_EQUAL(copied(sub), 3);
	CHECK(sub.get_topic() == ORB_ID(followed));
	CHECK(sub.orb_id() == ORB_ID::INVALID);
	CHECK((uORB::Subscription{ORB_ID::orb_test}.orb_id() == ORB_ID::orb_test));
	CHECK(!uORB::Subscription{}.updated());
	CHECK(!uORB::Subscription{ORB_ID::INVALID}.subscribe());
}

TOPIC(taken);

static void a_copy_of_a_subscription_has_seen_nothing()
{
	uORB::Publication<number_s> pub{ORB_ID(taken)};
	CHECK(pub.publish(number_s{1}));
	uORB::Subscription sub{ORB_ID(taken)};
	CHECK_EQUAL(copied(sub), 1);

	uORB::Subscription copy{sub};
	CHECK(!copy.valid());
	CHECK(copy.updated());
	CHECK(!sub.updated());
	uORB::Subscription moved{static_cast<uORB::Subscription &&>(copy)};
	CHECK(moved.updated());
	copy = sub;
	CHECK(!copy.valid());
	CHECK(copy.updated());
	moved = uORB::Subscription{ORB_ID(taken), 3};
	CHECK_EQUAL(moved.get_instance(), 3);
	CHECK(!moved.updated());
}

TOPIC(changed);

static void a_subscription_changes_to_an_instance_that_exists()
{
	uORB::PublicationMulti<number_s> pubs[2] {ORB_ID(changed), ORB_ID(changed)};
	CHECK(pubs[0].publish(number_s{10}) && pubs[1].publish(number_s{11}));
	uORB::Subscription sub{ORB_ID(changed)};
	CHECK_EQUAL(copied(sub), 10);
	CHECK(sub.ChangeInstance(0));
	CHECK(!sub.updated());
	CHECK(sub.ChangeInstance(1));
	CHECK_EQUAL(sub.get_instance(), 1);
	CHECK_EQUAL(copied(sub), 11);
	CHECK(!sub.ChangeInstance(2));
	CHECK_EQUAL(sub.get_instance(), 1);
	CHECK(sub.valid());
	CHECK(!uORB::Subscription{}.ChangeInstance(1));
}

TOPIC(array);

static void an_array_follows_all_instances()
{
	uORB::SubscriptionMultiArray<number_s> subs{ORB_ID(array)};
	static_assert(decltype(subs)::size() == ORB_MULTI_MAX_INSTANCES, "all of them");
	CHECK(!subs.advertised() && !subs.updated());
	uORB::PublicationMulti<number_s> pubs[3] {ORB_ID(array), ORB_ID(array), ORB_ID(array)};

	for (auto &pub : pubs) {
		CHECK(pub.advertise());
	}

	CHECK_EQUAL(subs.advertised_count(), 3);
	CHECK(subs.advertised() && !subs.updated());
	CHECK(pubs[1].unadvertise());
	CHECK_EQUAL(subs.advertised_count(), 2);
	CHECK(pubs[2].publish(number_s{2}));
	CHECK(subs.updated());
	CHECK(!subs[0].updated() && subs[2].updated());

	int instance = 0;
	const auto &constant = subs;

	for (const auto &sub : constant) {
		CHECK_EQUAL(sub.get_instance(), instance);
		instance++;
	}

	CHECK_EQUAL(instance, 10);
	uORB::SubscriptionMultiArray<orb_test_s, 2> two{ORB_ID::orb_test};
	CHECK_EQUAL(two.end() - two.begin(), 2);
}

TOPIC(paced);

static void an_interval_hides_updates_until_it_ends()
{
	constexpr uint32_t HOUR_US = 3600u * 1000 * 1000;
	number_s message{};
	uORB::Publication<number_s> pub{ORB_ID(paced)};
	uORB::SubscriptionInterval sub{ORB_ID(paced), HOUR_US};
	CHECK(pub.publish(number_s{1}));
	CHECK(sub.subscribe() && sub.valid() && sub.advertised());
	CHECK_EQUAL(sub.get_interval_us(), HOUR_US);

	// The first at once, even if the machine has been up for less than an hour.
	CHECK(sub.updated());
	CHECK(sub.update(&message));
	CHECK(pub.publish(number_s{2}));
	CHECK(!sub.updated() && !sub.update(&message));
	CHECK_EQUAL(message.n, 1);
	// A copy is not asked to wait.
	CHECK(sub.copy(&message));
	CHECK_EQUAL(message.n, 2);

	CHECK(pub.publish(number_s{3}));
	CHECK(!sub.updated());
	sub.set_interval_ms(0);
	CHECK(sub.updated());
	sub.set_interval_ms(3600 * 1000);
	CHECK_EQUAL(sub.get_interval_us(), HOUR_US);
	CHECK(!sub.updated());
	sub.set_interval_us(0);
	CHECK(sub.update(&message));
	CHECK_EQUAL(message.n, 3);

	// A copy that is late by half an interval leaves half of one to the next, and
	// however late it is, two updates follow each other, but not three.
	const hrt_abstime now = hrt_absolute_time();
	const uint32_t part_us = now / 8 < HOUR_US / 8 ? now / 8 : HOUR_US / 8;
	sub.set_interval_us(part_us);
	sub.set_last_update(now - part_us - part_us / 2);
	CHECK(pub.publish(number_s{4}) && sub.update(&message) && pub.publish(number_s{5}));
	sub.set_interval_us(part_us / 2);
	CHECK(sub.updated());
	sub.set_interval_us(part_us);
	sub.set_last_update(now - 8 * part_us + 1);
	CHECK(sub.update(&message) && pub.publish(number_s{6}));
	CHECK(sub.updated());
	sub.set_interval_us(4 * part_us);
	CHECK(!sub.updated());

	// They are one interval apart on average.
	constexpr uint32_t INTERVAL_US = 20 * 1000;
	sub.set_interval_us(INTERVAL_US);
	const hrt_abstime start = hrt_absolute_time();
	sub.set_last_update(start);

	for (int n = 1; n <= 5; n++) {
		CHECK(pub.publish(number_s{n}));

		while (!sub.update(&message)) {
			std::this_thread::yield();
		}

		CHECK(hrt_elapsed_time(&start) >= static_cast<hrt_abstime>(n) * INTERVAL_US);
	}

	CHECK(sub.get_topic() == ORB_ID(paced));
	CHECK_EQUAL(sub.get_instance(), 0);
	CHECK(sub.get_last_generation() >= 8);
	sub.unsubscribe();
	CHECK(!sub.valid());
	CHECK((!uORB::SubscriptionInterval{}.updated()));
	CHECK((!uORB::SubscriptionInterval{ORB_ID::INVALID, 1000, 1}.copy(&message)));
}

/** Counts, and copies what there is. */
class Counting : public uORB::SubscriptionCallback
{
public:
	using SubscriptionCallback::SubscriptionCallback;
	~Counting() override { unregisterCallback(); }

	void call() override
	{
		number_s message{};

		while (update(&message)) {
			last = message.n;
		}

		calls++;
	}

	std::atomic<int> calls{0};
	std::atomic<int> last{-1};
};

/** Waits for what another thread does. */
template<typename Condition>
static void until(Condition is_so)
{
	const hrt_abstime start = hrt_absolute_time();

	while (!is_so()) {
		CHECK(hrt_elapsed_time(&start) < PATIENCE_US);
		std::this_thread::yield();
	}
}

TOPIC(called);

static void a_callback_is_called_after_each_publish()
{
	Counting counting{ORB_ID(called)};
	CHECK(!counting.registered());
	// The node is made.
	CHECK(counting.registerCallback() && counting.registered() && counting.valid());
	CHECK(counting.registerCallback());
	CHECK_EQUAL(orb_group_count(ORB_ID(called)), 1);

	uORB::PublicationMulti<number_s> pub{ORB_ID(called)};
	CHECK_EQUAL(pub.get_instance(), 0);

	for (int n = 1; n <= ROUNDS / 5; n++) {
		const int before = counting.calls;
		CHECK(pub.publish(number_s{n}));
		// A call that has not returned yet would take the next message, too.
		until([&] { return counting.last == n && counting.calls > before; });
	}

	// None after it is over.
	counting.unregisterCallback();
	CHECK(!counting.registered());
	const int calls = counting.calls;
	CHECK(pub.publish(number_s{0}));
	CHECK_EQUAL(counting.calls, calls);
	CHECK_EQUAL(counting.last, ROUNDS / 5);

	// It goes along to another instance, and stays where that does not exist.
	uORB::PublicationMulti<number_s> second{ORB_ID(called)};
	CHECK(second.advertise());
	CHECK(counting.registerCallback());
	CHECK(counting.ChangeInstance(1) && counting.registered());
	CHECK(!counting.ChangeInstance(7) && counting.registered());
	CHECK(counting.ChangeInstance(1));
	CHECK(second.publish(number_s{-7}));
	until([&] { return counting.last == -7; });

	// Callbacks come and go while others publish.
	std::atomic<bool> is_over{false};
	std::thread publisher{[&] {
		while (!is_over) {
			CHECK(second.publish(number_s{5}));
		}
	}};

	for (int i = 0; i < 100; i++) {
		Counting brief{ORB_ID(called), 0, 1};
		CHECK(brief.registerCallback());
		until([&] { return brief.calls > 0; });
	}

	is_over = true;
	publisher.join();
}

TOPIC(asked);
TOPIC(answered);

static void a_blocking_subscription_loses_no_wake()
{
	std::thread answers{[&] {
		uORB::SubscriptionBlocking<number_s> asked{ORB_ID(asked)};
		uORB::Publication<number_s> answer{ORB_ID(answered)};
		number_s message{};

		while (message.n < ROUNDS) {
			CHECK(asked.updateBlocking(message, PATIENCE_US));
			CHECK(answer.publish(message));
		}
	}};
	uORB::Publication<number_s> ask{ORB_ID(asked)};
	uORB::SubscriptionBlocking<number_s> answered{ORB_ID(answered)};
	number_s message{};

	// Each waits for the other: one wake that is lost, and both wait in vain.
	for (int n = 1; n <= ROUNDS; n++) {
		CHECK(ask.publish(number_s{n}));
		CHECK(answered.updateBlocking(message, PATIENCE_US));
		CHECK_EQUAL(message.n, n);
	}

	answers.join();
	CHECK(!answered.registered());
}

TOPIC(flood);

static void a_blocking_subscription_keeps_up_with_a_fast_publisher()
{
	constexpr int MESSAGES = ROUNDS * 40;
	uORB::SubscriptionBlocking<number_s> sub{ORB_ID(flood)};
	std::thread publisher{[&] {
		uORB::Publication<number_s> pub{ORB_ID(flood)};

		for (int n = 1; n <= MESSAGES; n++) {
			CHECK(pub.publish(number_s{n}));
		}
	}};
	number_s message{};

	// However many it misses, the last one it gets: a timeout of 0 is none.
	for (int last = 0; last < MESSAGES; last = message.n) {
		CHECK(sub.updateBlocking(message));
		CHECK(message.n > last);
	}

	publisher.join();
}

TOPIC(awaited);

static void a_blocking_subscription_waits_no_longer_than_it_is_told()
{
	constexpr uint32_t TIMEOUT_US = 20 * 1000;
	constexpr uint32_t HOUR_US = 3600u * 1000 * 1000;
	uORB::SubscriptionBlocking<number_s> sub{ORB_ID(awaited)};
	number_s message{};
	hrt_abstime start = hrt_absolute_time();
	// It makes the node, to have something to wait at.
	CHECK_FAILS(sub.updatedBlocking(TIMEOUT_US), false, 0);
	CHECK(sub.valid());
	CHECK(hrt_elapsed_time(&start) >= TIMEOUT_US);

	uORB::Publication<number_s> pub{ORB_ID(awaited)};
	CHECK(pub.publish(number_s{1}));
	CHECK(sub.updatedBlocking());
	CHECK(sub.updateBlocking(message));
	CHECK_EQUAL(message.n, 1);
	CHECK_FAILS(sub.updateBlocking(message, TIMEOUT_US), false, 0);

	// An interval is waited for, as far as the timeout goes.
	sub.set_interval_us(HOUR_US);
	sub.set_last_update(hrt_absolute_time());
	CHECK(pub.publish(number_s{2}));
	start = hrt_absolute_time();
	CHECK_FAILS(sub.updatedBlocking(TIMEOUT_US), false, 0);
	CHECK(hrt_elapsed_time(&start) >= TIMEOUT_US);
	start = hrt_absolute_time();
	sub.set_interval_us(TIMEOUT_US);
	sub.set_last_update(start);
	CHECK(sub.updateBlocking(message));
	CHECK(hrt_elapsed_time(&start) >= TIMEOUT_US);
	CHECK_EQUAL(message.n, 2);

	// No topic, nothing to wait for.
	uORB::SubscriptionBlocking<number_s> of_nothing{ORB_ID::INVALID};
	CHECK_FAILS(of_nothing.updatedBlocking(), false, ENOENT);
}

int main()
{
#define RUN(_test) _test(); printf("PASS " #_test "\n")
	RUN(a_publication_is_a_pointer);
	RUN(a_publication_advertises_when_it_first_publishes);
	RUN(a_publication_of_a_queue_stays_advertised);
	RUN(a_publication_may_ask_for_a_queue);
	RUN(publications_and_subscriptions_may_have_their_message_within);
	RUN(publications_of_instances_claim_the_lowest);
	RUN(a_subscription_looks_for_its_node_at_every_call);
	RUN(a_copy_of_a_subscription_has_seen_nothing);
	RUN(a_subscription_changes_to_an_instance_that_exists);
	RUN(an_array_follows_all_instances);
	RUN(an_interval_hides_updates_until_it_ends);
	RUN(a_callback_is_called_after_each_publish);
	RUN(a_blocking_subscription_loses_no_wake);
	RUN(a_blocking_subscription_keeps_up_with_a_fast_publisher);
	RUN(a_blocking_subscription_waits_no_longer_than_it_is_told);
	return 0;
}
