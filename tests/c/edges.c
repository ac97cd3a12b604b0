/* What PX4's own tests leave out: nothing published yet, NULL, handles that are
 * none, the eleventh instance, intervals, a reader far behind, many waiters, and
 * all the ways to wait. */

#include <limits.h>
#include <poll.h>
#include <pthread.h>
#include <sys/epoll.h>
#include <unistd.h>

#include <drivers/drv_hrt.h>
#include <px4_platform_common/posix.h>

#include <uORB/uORB.h>
#include <uORB/topics/orb_test.h>
#include <uORB/topics/orb_test_medium.h>

#include "check.h"

/* One that nobody has. */
struct number_data {
	int n;
};
ORB_DEFINE(number);

/* Subscribed only where somebody else has described it. */
struct nowhere_s {
	int n;
};
ORB_DEFINE_OPTIONAL(nowhere, struct nowhere_s);
ORB_DECLARE_OPTIONAL(undefined);

static bool check(int sub)
{
	bool updated = true;
	CHECK_EQUAL(orb_check(sub, &updated), 0);
	return updated;
}

static int copy(int sub)
{
	struct number_data data = {-1};
	CHECK_EQUAL(orb_copy(ORB_ID(number), sub, &data), 0);
	return data.n;
}

static void publish(orb_advert_t pub, int n)
{
	const struct number_data data = {n};
	CHECK_EQUAL(orb_publish(ORB_ID(number), pub, &data), 0);
}

static int wait_for(int sub, int timeout_ms)
{
	px4_pollfd_struct_t fd = {.fd = sub, .events = POLLIN};
	return px4_poll(&fd, 1, timeout_ms);
}

static void nothing_is_published_yet(void)
{
	struct number_data data;
	uint64_t time = 1;
	CHECK_EQUAL(orb_group_count(ORB_ID(number)), 0);
	CHECK_EQUAL(orb_exists(ORB_ID(number), 0), -1);

	const int sub = orb_subscribe(ORB_ID(number));
	CHECK(sub >= 0);
	CHECK(!check(sub));
	CHECK_FAILS(orb_copy(ORB_ID(number), sub, &data), -1, EIO);
	CHECK_EQUAL(orb_stat(sub, &time), 0);
	CHECK_EQUAL(time, 0);
	/* It exists, and nobody has advertised it. */
	CHECK_EQUAL(orb_group_count(ORB_ID(number)), 1);
	CHECK_EQUAL(orb_exists(ORB_ID(number), 0), -1);

	const orb_advert_t pub = orb_advertise(ORB_ID(number), NULL);
	CHECK(pub > 0);
	CHECK_EQUAL(orb_exists(ORB_ID(number), 0), 0);
	CHECK_EQUAL(orb_get_instance(pub), 0);
	CHECK(!check(sub));
	CHECK_FAILS(orb_copy(ORB_ID(number), sub, &data), -1, EIO);
	CHECK_EQUAL(wait_for(sub, 0), 0);

	const hrt_abstime before = hrt_absolute_time();
	publish(pub, 1);
	CHECK_EQUAL(orb_stat(sub, &time), 0);
	CHECK(time >= before && time <= hrt_absolute_time());
	CHECK_EQUAL(copy(sub), 1);
	/* Once more, and it is the same. */
	CHECK_EQUAL(copy(sub), 1);
	CHECK_EQUAL(orb_unadvertise(pub), 0);
	CHECK_EQUAL(orb_unsubscribe(sub), 0);
}

static void an_unadvertised_topic_keeps_its_last_message(void)
{
	orb_advert_t pub = orb_advertise(ORB_ID(number), NULL);
	const int early = orb_subscribe(ORB_ID(number));
	publish(pub, 2);
	CHECK_EQUAL(orb_unadvertise(pub), 0);
	CHECK_EQUAL(orb_exists(ORB_ID(number), 0), -1);

	CHECK(check(early));
	CHECK_EQUAL(wait_for(early, PATIENCE_MS), 1);
	CHECK_EQUAL(copy(early), 2);
	CHECK(!check(early));

	const int late = orb_subscribe(ORB_ID(number));
	CHECK(check(late));
	CHECK_EQUAL(copy(late), 2);

	/* To advertise again is not to publish. */
	pub = orb_advertise(ORB_ID(number), NULL);
	CHECK(!check(early));
	CHECK(!check(late));
	CHECK_EQUAL(orb_unadvertise(pub), 0);
	CHECK_EQUAL(orb_unsubscribe(early), 0);
	CHECK_EQUAL(orb_unsubscribe(late), 0);
}

static void a_copy_to_nowhere_takes_all_as_seen(void)
{
	const orb_advert_t pub = orb_advertise(ORB_ID(number), NULL);
	const int sub = orb_subscribe(ORB_ID(number));
	publish(pub, 3);
	CHECK(check(sub));
	CHECK_EQUAL(orb_copy(ORB_ID(number), sub, NULL), 0);
	CHECK(!check(sub));
	CHECK_EQUAL(copy(sub), 3);
	CHECK_EQUAL(orb_unadvertise(pub), 0);
	CHECK_EQUAL(orb_unsubscribe(sub), 0);
}

static void null_is_an_errno(void)
{
	struct number_data data = {0};
	orb_advert_t none = -1;
	int instance = 7;
	const orb_advert_t pub = orb_advertise(ORB_ID(number), NULL);
	const int sub = orb_subscribe(ORB_ID(number));
	CHECK(pub > 0 && sub >= 0);

	CHECK_FAILS(orb_advertise(NULL, &data), -1, ENOENT);
	CHECK_FAILS(orb_advertise_queue(NULL, &data, 4), -1, ENOENT);
	CHECK_FAILS(orb_advertise_multi(NULL, &data, &instance, ORB_PRIO_MAX), -1, ENOENT);
	CHECK_FAILS(orb_advertise_multi_queue(NULL, &data, &instance, ORB_PRIO_MAX, 4), -1, ENOENT);
	CHECK_FAILS(orb_publish_auto(NULL, &none, &data, &instance), -1, ENOENT);
	CHECK_FAILS(orb_publish_auto(ORB_ID(number), NULL, &data, &instance), -1, EFAULT);
	CHECK_FAILS(orb_unadvertise(-1), -1, EINVAL);
	CHECK_FAILS(orb_publish(NULL, pub, &data), -1, EFAULT);
	CHECK_FAILS(orb_publish(ORB_ID(number), -1, &data), -1, EFAULT);
	CHECK_FAILS(orb_publish(ORB_ID(number), pub, NULL), -1, EFAULT);
	CHECK_FAILS(orb_subscribe(NULL), -1, ENOENT);
	CHECK_FAILS(orb_subscribe_multi(NULL, 0), -1, ENOENT);
	CHECK_FAILS(orb_copy(NULL, sub, &data), -1, EFAULT);
	CHECK_FAILS(orb_check(sub, NULL), -1, EFAULT);
	CHECK_FAILS(orb_stat(sub, NULL), -1, EFAULT);
	CHECK_FAILS(orb_priority(sub, NULL), -1, EFAULT);
	CHECK_FAILS(orb_get_interval(sub, NULL), -1, EFAULT);
	CHECK_FAILS(orb_exists(NULL, 0), -1, ENOENT);
	CHECK_FAILS(orb_group_count(NULL), -1, ENOENT);
	CHECK_EQUAL(orb_get_queue_size(NULL), 0);
	CHECK_FAILS(px4_poll(NULL, 1, 0), -1, EINVAL);

	/* Topics that the program does not have, or nobody has described. */
	CHECK(ORB_ID(undefined) == NULL);
	CHECK_FAILS(orb_subscribe(ORB_ID(undefined)), -1, ENOENT);
	CHECK_FAILS(orb_subscribe(ORB_ID(nowhere)), -1, ENOENT);

	CHECK_EQUAL(orb_unadvertise(pub), 0);
	CHECK_EQUAL(orb_unsubscribe(sub), 0);
}

static void a_handle_that_is_none_is_found_out(void)
{
	struct number_data data = {0};
	bool updated = true;
	uint64_t time;
	int32_t priority;
	unsigned interval;
	const orb_advert_t pub = orb_advertise(ORB_ID(number), NULL);
	const int sub = orb_subscribe(ORB_ID(number));
	const int stale = orb_subscribe(ORB_ID(number));
	CHECK_EQUAL(orb_unsubscribe(stale), 0);
	int pipes[2];
	CHECK_EQUAL(pipe(pipes), 0);

	/* Given back, never given, far away, and a descriptor of another kind. */
	const int none[] = {stale, -1, INT_MIN, INT_MAX, pipes[0], pub + 500};

	for (size_t i = 0; i < sizeof(none) / sizeof(none[0]); i++) {
		CHECK_FAILS(orb_unsubscribe(none[i]), -1, EBADF);
		CHECK_FAILS(orb_copy(ORB_ID(number), none[i], &data), -1, EBADF);
		CHECK_FAILS(orb_check(none[i], &updated), -1, EBADF);
		CHECK(!updated);
		CHECK_FAILS(orb_stat(none[i], &time), -1, EBADF);
		CHECK_FAILS(orb_priority(none[i], &priority), -1, EBADF);
		CHECK_FAILS(orb_set_interval(none[i], 1), -1, EBADF);
		CHECK_FAILS(orb_get_interval(none[i], &interval), -1, EBADF);
	}

	CHECK_EQUAL(orb_unadvertise(pub), 0);
	const int gone[] = {pub, INT_MAX, 12345};

	for (size_t i = 0; i < sizeof(gone) / sizeof(gone[0]); i++) {
		CHECK_FAILS(orb_publish(ORB_ID(number), gone[i], &data), -1, EBADF);
		CHECK_FAILS(orb_unadvertise(gone[i]), -1, EBADF);
		CHECK_FAILS(orb_get_instance(gone[i]), -1, EBADF);
	}

	/* A new publication has another handle, and the old one stays none. */
	const orb_advert_t again = orb_advertise(ORB_ID(number), NULL);
	CHECK(again > 0 && again != pub);
	CHECK_FAILS(orb_publish(ORB_ID(number), pub, &data), -1, EBADF);

	/* Another topic's. */
	CHECK_FAILS(orb_publish(ORB_ID(orb_test), again, &data), -1, EINVAL);
	publish(again, 4);
	CHECK_FAILS(orb_copy(ORB_ID(orb_test), sub, &data), -1, EIO);
	CHECK_EQUAL(copy(sub), 4);

	CHECK_EQUAL(orb_unadvertise(again), 0);
	CHECK_EQUAL(orb_unsubscribe(sub), 0);
	close(pipes[0]);
	close(pipes[1]);
}

static void the_eleventh_instance_is_refused(void)
{
	orb_advert_t pubs[ORB_MULTI_MAX_INSTANCES];
	int instance;

	for (int i = 0; i < ORB_MULTI_MAX_INSTANCES; i++) {
		/* In C the priority may be left out. */
		pubs[i] = i % 2 == 0 ? orb_advertise_multi(ORB_ID(number), NULL, &instance)
			  : orb_advertise_multi(ORB_ID(number), NULL, &instance, ORB_PRIO_HIGH);
		CHECK_EQUAL(instance, i);
		CHECK_EQUAL(orb_get_instance(pubs[i]), i);
	}

	CHECK_EQUAL(orb_group_count(ORB_ID(number)), ORB_MULTI_MAX_INSTANCES);
	CHECK_FAILS(orb_advertise_multi(ORB_ID(number), NULL, &instance), -1, EIO);
	CHECK_FAILS(orb_subscribe_multi(ORB_ID(number), ORB_MULTI_MAX_INSTANCES), -1, EIO);
	CHECK_EQUAL(orb_exists(ORB_ID(number), ORB_MULTI_MAX_INSTANCES), -1);
	CHECK_EQUAL(orb_exists(ORB_ID(number), -1), -1);

	/* A single publisher shares the first. */
	const orb_advert_t shares = orb_advertise(ORB_ID(number), NULL);
	CHECK_EQUAL(orb_get_instance(shares), 0);
	CHECK_EQUAL(orb_unadvertise(shares), 0);

	/* What becomes free is claimed again. */
	CHECK_EQUAL(orb_unadvertise(pubs[6]), 0);
	orb_advert_t none = -1;
	const struct number_data data = {6};
	CHECK_EQUAL(orb_publish_auto(ORB_ID(number), &none, &data, &instance), 0);
	CHECK_EQUAL(instance, 6);
	pubs[6] = none;
	CHECK_EQUAL(orb_publish_auto(ORB_ID(number), &pubs[6], &data, &instance, ORB_PRIO_LOW), 0);
	CHECK_EQUAL(pubs[6], none);

	for (int i = 0; i < ORB_MULTI_MAX_INSTANCES; i++) {
		CHECK_EQUAL(orb_unadvertise(pubs[i]), 0);
	}
}

static void a_reader_far_behind_gets_the_newest(void)
{
	const orb_advert_t pub = orb_advertise(ORB_ID(number), NULL);
	const int sub = orb_subscribe(ORB_ID(number));

	for (int n = 0; n < 10000; n++) {
		publish(pub, n);
	}

	CHECK(check(sub));
	CHECK_EQUAL(copy(sub), 9999);
	CHECK(!check(sub));
	CHECK_EQUAL(orb_unadvertise(pub), 0);
	CHECK_EQUAL(orb_unsubscribe(sub), 0);
}

static void queues_are_deepened_before_the_first_publish(void)
{
	/* A node of its own: instance 9 of a topic that keeps one message. */
	int instance;
	const orb_advert_t pub = orb_advertise_multi_queue(ORB_ID(orb_multitest), NULL, &instance, ORB_PRIO_LOW, 5);
	CHECK(pub > 0);
	const int sub = orb_subscribe_multi(ORB_ID(orb_multitest), (unsigned)instance);

	for (int n = 0; n < 20; n++) {
		const struct orb_test_s message = {.val = n};
		CHECK_EQUAL(orb_publish(ORB_ID(orb_multitest), pub, &message), 0);
	}

	/* Rounded up to eight. */
	for (int n = 12; n < 20; n++) {
		struct orb_test_s message;
		CHECK(check(sub));
		CHECK_EQUAL(orb_copy(ORB_ID(orb_multitest), sub, &message), 0);
		CHECK_EQUAL(message.val, n);
	}

	CHECK(!check(sub));
	int32_t priority;
	CHECK_EQUAL(orb_priority(sub, &priority), 0);
	CHECK_EQUAL(priority, ORB_PRIO_LOW);
	CHECK_EQUAL(orb_unadvertise(pub), 0);
	CHECK_EQUAL(orb_unsubscribe(sub), 0);
}

static void an_interval_hides_updates_until_it_ends(void)
{
	const unsigned hour_ms = 3600 * 1000;
	const unsigned short_ms = 50;
	unsigned interval = 1;
	const orb_advert_t pub = orb_advertise(ORB_ID(number), NULL);
	const int sub = orb_subscribe(ORB_ID(number));
	CHECK_EQUAL(orb_copy(ORB_ID(number), sub, NULL), 0);
	CHECK_EQUAL(orb_get_interval(sub, &interval), 0);
	CHECK_EQUAL(interval, 0);
	CHECK_EQUAL(orb_set_interval(sub, hour_ms), 0);
	CHECK_EQUAL(orb_get_interval(sub, &interval), 0);
	CHECK_EQUAL(interval, hour_ms);

	/* The first update is seen at once, and stays one until it is copied. */
	publish(pub, 1);
	CHECK(check(sub));
	CHECK(check(sub));
	CHECK_EQUAL(wait_for(sub, -1), 1);
	CHECK_EQUAL(copy(sub), 1);

	/* The next is not, by any way of looking. A copy gets it all the same. */
	publish(pub, 2);
	CHECK(!check(sub));
	CHECK_EQUAL(wait_for(sub, 0), 0);
	CHECK_EQUAL(copy(sub), 2);
	publish(pub, 3);
	CHECK(!check(sub));

	/* Without an interval it is there. */
	CHECK_EQUAL(orb_set_interval(sub, 0), 0);
	CHECK(check(sub));
	CHECK_EQUAL(copy(sub), 3);

	/* The end of the interval wakes with what was published meanwhile. */
	CHECK_EQUAL(orb_set_interval(sub, short_ms), 0);
	publish(pub, 4);
	CHECK_EQUAL(wait_for(sub, -1), 1);
	const hrt_abstime start = hrt_absolute_time();
	CHECK_EQUAL(copy(sub), 4);
	publish(pub, 5);
	publish(pub, 6);
	CHECK_EQUAL(wait_for(sub, -1), 1);
	CHECK_EQUAL(copy(sub), 6);
	/* Two updates are an interval apart, and the first was seen before start. */
	publish(pub, 7);
	CHECK_EQUAL(wait_for(sub, -1), 1);
	CHECK_EQUAL(copy(sub), 7);
	CHECK(hrt_elapsed_time(&start) >= short_ms * 1000);

	CHECK_EQUAL(orb_unadvertise(pub), 0);
	CHECK_EQUAL(orb_unsubscribe(sub), 0);
}

static void poll_epoll_and_px4_poll_agree(void)
{
	const orb_advert_t pub = orb_advertise(ORB_ID(number), NULL);
	const int sub = orb_subscribe(ORB_ID(number));
	CHECK_EQUAL(orb_copy(ORB_ID(number), sub, NULL), 0);
	const int epoll = epoll_create1(EPOLL_CLOEXEC);
	struct epoll_event event = {.events = EPOLLIN, .data = {.fd = sub}};
	CHECK_EQUAL(epoll_ctl(epoll, EPOLL_CTL_ADD, sub, &event), 0);

	for (int n = 0; n < 1000; n++) {
		struct pollfd fd = {.fd = sub, .events = POLLIN};
		CHECK_EQUAL(poll(&fd, 1, 0), 0);
		CHECK_EQUAL(px4_poll(&fd, 1, 0), 0);
		CHECK_EQUAL(epoll_wait(epoll, &event, 1, 0), 0);

		publish(pub, n);
		CHECK_EQUAL(poll(&fd, 1, PATIENCE_MS), 1);
		CHECK_EQUAL(fd.revents, POLLIN);
		CHECK_EQUAL(px4_poll(&fd, 1, PATIENCE_MS), 1);
		CHECK_EQUAL(fd.revents, POLLIN);
		CHECK_EQUAL(epoll_wait(epoll, &event, 1, PATIENCE_MS), 1);
		CHECK_EQUAL(event.data.fd, sub);
		CHECK_EQUAL(copy(sub), n);
	}

	/* Among others: a closed descriptor is passed over, a pipe is as ever. */
	int pipes[2];
	CHECK_EQUAL(pipe(pipes), 0);
	px4_pollfd_struct_t fds[] = {
		{.fd = sub, .events = POLLIN}, {.fd = -1, .events = POLLIN}, {.fd = pipes[0], .events = POLLIN},
	};
	CHECK_EQUAL(px4_poll(fds, 3, 0), 0);
	CHECK_EQUAL(write(pipes[1], "x", 1), 1);
	CHECK_EQUAL(px4_poll(fds, 3, PATIENCE_MS), 1);
	CHECK(fds[2].revents & POLLIN);
	publish(pub, 1);
	CHECK_EQUAL(px4_poll(fds, 3, PATIENCE_MS), 2);
	CHECK(fds[0].revents == POLLIN && fds[1].revents == 0 && fds[2].revents == POLLIN);

	close(epoll);
	close(pipes[0]);
	close(pipes[1]);
	CHECK_EQUAL(orb_unadvertise(pub), 0);
	CHECK_EQUAL(orb_unsubscribe(sub), 0);
}

enum { WAITERS = 100 };

static pthread_barrier_t all_have_subscribed;

static void *wait_and_copy(void *argument)
{
	(void)argument;
	const int sub = orb_subscribe(ORB_ID(number));
	CHECK_EQUAL(orb_copy(ORB_ID(number), sub, NULL), 0);
	pthread_barrier_wait(&all_have_subscribed);
	CHECK_EQUAL(wait_for(sub, PATIENCE_MS), 1);
	CHECK_EQUAL(copy(sub), 42);
	CHECK_EQUAL(orb_unsubscribe(sub), 0);
	return NULL;
}

static void a_hundred_waiters_are_woken_by_one_publish(void)
{
	pthread_t waiters[WAITERS];
	const orb_advert_t pub = orb_advertise(ORB_ID(number), NULL);
	pthread_barrier_init(&all_have_subscribed, NULL, WAITERS + 1);

	for (int i = 0; i < WAITERS; i++) {
		CHECK_EQUAL(pthread_create(&waiters[i], NULL, wait_and_copy, NULL), 0);
	}

	pthread_barrier_wait(&all_have_subscribed);
	publish(pub, 42);

	for (int i = 0; i < WAITERS; i++) {
		pthread_join(waiters[i], NULL);
	}

	pthread_barrier_destroy(&all_have_subscribed);
	CHECK_EQUAL(orb_unadvertise(pub), 0);
}

int main(void)
{
#define RUN(_test) (_test(), printf("PASS " #_test "\n"))
	RUN(nothing_is_published_yet);
	RUN(an_unadvertised_topic_keeps_its_last_message);
	RUN(a_copy_to_nowhere_takes_all_as_seen);
	RUN(null_is_an_errno);
	RUN(a_handle_that_is_none_is_found_out);
	RUN(the_eleventh_instance_is_refused);
	RUN(a_reader_far_behind_gets_the_newest);
	RUN(queues_are_deepened_before_the_first_publish);
	RUN(an_interval_hides_updates_until_it_ends);
	RUN(poll_epoll_and_px4_poll_agree);
	RUN(a_hundred_waiters_are_woken_by_one_publish);
	return 0;
}
