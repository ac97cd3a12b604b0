/* Threads share one publication, have subscriptions of their own, and open and
 * close handles while others use theirs. */

#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <unistd.h>

#include <uORB/uORB.h>
#include <px4_platform_common/posix.h>

enum { THREADS = 4, MESSAGES = 50000 };

struct shared_data {
	int64_t writer;
	int64_t number;
	int64_t check[6];
};
ORB_DEFINE(shared);

static orb_advert_t pub;
static atomic_int failures, writing = THREADS;
static atomic_long copied;
/* Nobody publishes before all follow. */
static pthread_barrier_t start;

static void fail(const char *what)
{
	perror(what);
	atomic_fetch_add(&failures, 1);
}

static void *publish(void *argument)
{
	struct shared_data data = {(intptr_t)argument, 0, {0}};
	pthread_barrier_wait(&start);

	while (data.number < MESSAGES) {
		data.number++;

		for (int i = 0; i < 6; i++) {
			data.check[i] = data.writer * 1000003 + data.number * (i + 1);
		}

		while (orb_publish(ORB_ID(shared), pub, &data) != 0) {
			if (errno != EAGAIN) {
				fail("orb_publish");
				return NULL;
			}
		}
	}

	atomic_fetch_sub(&writing, 1);
	return NULL;
}

static void *follow(void *argument)
{
	(void)argument;
	int64_t seen[THREADS] = {0};
	const int sub = orb_subscribe(ORB_ID(shared));
	px4_pollfd_struct_t fd = {sub, POLLIN, 0};

	if (sub < 0) {
		fail("orb_subscribe");
	}

	pthread_barrier_wait(&start);

	while (atomic_load(&writing) > 0) {
		/* The last message may be copied by now: then nobody wakes us. */
		if (px4_poll(&fd, 1, 100) <= 0) {
			continue;
		}

		struct shared_data data;

		if (orb_copy(ORB_ID(shared), sub, &data) != 0) {
			fail("orb_copy");
		}

		for (int i = 0; i < 6; i++) {
			if (data.check[i] != data.writer * 1000003 + data.number * (i + 1)) {
				fail("a torn message");
			}
		}

		if (data.number <= seen[data.writer]) {
			fail("a message out of order");
		}

		seen[data.writer] = data.number;
		atomic_fetch_add(&copied, 1);
	}

	orb_unsubscribe(sub);
	return NULL;
}

static void *come_and_go(void *argument)
{
	(void)argument;

	while (atomic_load(&writing) > 0) {
		const int sub = orb_subscribe(ORB_ID(shared));
		const orb_advert_t other = orb_advertise(ORB_ID(shared), NULL);
		struct shared_data data;
		orb_copy(ORB_ID(shared), sub, &data);

		if (sub < 0 || other < 0 || orb_unadvertise(other) != 0 || orb_unsubscribe(sub) != 0) {
			fail("coming and going");
			break;
		}

		/* Somebody else's number by now, or nobody's: never a crash. */
		bool updated;
		orb_check(sub, &updated);

		if (orb_publish(ORB_ID(shared), other, &data) != -1) {
			fail("a stale publication");
		}
	}

	return NULL;
}

int main(void)
{
	pub = orb_advertise(ORB_ID(shared), NULL);

	if (pub < 0) {
		return 1;
	}

	pthread_barrier_init(&start, NULL, 2 * THREADS);
	pthread_t threads[2 * THREADS + 1];

	for (intptr_t i = 0; i < THREADS; i++) {
		pthread_create(&threads[i], NULL, publish, (void *)i);
		pthread_create(&threads[THREADS + i], NULL, follow, NULL);
	}

	pthread_create(&threads[2 * THREADS], NULL, come_and_go, NULL);

	for (int i = 0; i < 2 * THREADS + 1; i++) {
		pthread_join(threads[i], NULL);
	}

	if (atomic_load(&copied) == 0) {
		fail("nothing was copied");
	}

	return atomic_load(&failures);
}
