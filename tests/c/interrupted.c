/* Publishes on two topics, and from a handler of SIGALRM on both as well, until
 * a hundred signals have interrupted a publish. Says then how many messages it
 * has published on each. */

#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/time.h>

#include <uORB/uORB.h>

struct interrupted_data {
	int32_t number;  /* of the messages of this writer, 1 and up */
	int32_t writer;  /* 1: the handler */
	int64_t check;   /* of both */
};
ORB_DEFINE(interrupted);
ORB_DEFINE(other, struct interrupted_data);

static orb_advert_t interrupted_pub, other_pub;
static volatile sig_atomic_t is_publishing, interruptions, handled, refused;

static struct interrupted_data message(int32_t number, int32_t writer)
{
	struct interrupted_data data;
	data.number = number;
	data.writer = writer;
	data.check = ~(((int64_t)number << 32) + writer);
	return data;
}

static void on_alarm(int signal)
{
	(void)signal;
	interruptions += is_publishing;
	struct interrupted_data data = message(handled + 1, 1);

	if (orb_publish(ORB_ID(interrupted), interrupted_pub, &data) != 0
	    || orb_publish(ORB_ID(other), other_pub, &data) != 0) {
		refused++;
		return;
	}

	handled++;
}

int main(void)
{
	interrupted_pub = orb_advertise(ORB_ID(interrupted), NULL);
	other_pub = orb_advertise(ORB_ID(other), NULL);

	if (interrupted_pub < 0 || other_pub < 0) {
		return 1;
	}

	/* Somebody may want to follow first. */
	puts("ready");
	fflush(stdout);

	while (getchar() != '\n') {
	}

	struct sigaction action;
	memset(&action, 0, sizeof(action));
	action.sa_handler = on_alarm;
	sigaction(SIGALRM, &action, NULL);
	const struct itimerval often = {{0, 50}, {0, 50}}, never = {{0, 0}, {0, 0}};
	setitimer(ITIMER_REAL, &often, NULL);

	int32_t published = 0;

	while (interruptions < 100 && refused == 0) {
		struct interrupted_data data = message(published + 1, 0);
		is_publishing = 1;
		const int result = orb_publish(ORB_ID(interrupted), interrupted_pub, &data);
		is_publishing = 0;

		if (result != 0) {
			perror("orb_publish");
			return 1;
		}

		published++;
	}

	setitimer(ITIMER_REAL, &never, NULL);
	printf("%d by the program, %d by the handler, %d refused\n", published, (int)handled, (int)refused);
	fflush(stdout);
	/* What is on a stream goes with its publisher. */
	getchar();
	return 0;
}
