/* A process in C that a story directs: one command a line on stdin, one line of
 * answer. Where a call fails the answer is the name of errno. */

#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <px4_platform_common/posix.h>

#include <uORB/uORB.h>
#include <uORB/topics/orb_test.h>

static const char *name_of(int number)
{
	switch (number) {
	case EBADF: return "EBADF";
	case ECONNREFUSED: return "ECONNREFUSED";
	case EFAULT: return "EFAULT";
	case EINVAL: return "EINVAL";
	case EIO: return "EIO";
	case ESHUTDOWN: return "ESHUTDOWN";
	default: return strerror(number);
	}
}

static void answer(int result)
{
	puts(result == 0 ? "ok" : name_of(errno));
}

int main(void)
{
	char command[32];
	int argument;
	orb_advert_t pub = -1;
	int sub = -1;
	setvbuf(stdout, NULL, _IOLBF, 0);

	/* Every command has a number, which not all need. */
	while (scanf("%31s %d", command, &argument) == 2) {
		struct orb_test_s message = {.timestamp = 0, .val = argument};

		if (strcmp(command, "advertise") == 0) {
			pub = orb_advertise(ORB_ID(orb_test), NULL);
			answer(pub > 0 ? 0 : -1);

		} else if (strcmp(command, "advertise_multi") == 0) {
			int instance = -1;
			pub = orb_advertise_multi(ORB_ID(orb_test), NULL, &instance);
			printf("%s\n", pub > 0 ? (char[]) {'0' + (char)instance, '\0'} : name_of(errno));

		} else if (strcmp(command, "unadvertise") == 0) {
			answer(orb_unadvertise(pub));

		} else if (strcmp(command, "publish") == 0) {
			answer(orb_publish(ORB_ID(orb_test), pub, &message));

		} else if (strcmp(command, "subscribe") == 0) {
			sub = orb_subscribe_multi(ORB_ID(orb_test), (unsigned)argument);
			answer(sub >= 0 ? 0 : -1);

		} else if (strcmp(command, "copy") == 0) {
			if (orb_copy(ORB_ID(orb_test), sub, &message) == 0) {
				printf("%" PRId32 "\n", message.val);

			} else {
				answer(-1);
			}

		} else if (strcmp(command, "check") == 0) {
			bool updated;

			if (orb_check(sub, &updated) == 0) {
				puts(updated ? "updated" : "nothing new");

			} else {
				answer(-1);
			}

		} else if (strcmp(command, "poll") == 0) {
			px4_pollfd_struct_t fd = {.fd = sub, .events = POLLIN};
			const int ready = px4_poll(&fd, 1, argument);

			if (ready < 0) {
				answer(-1);

			} else {
				puts(ready == 1 ? "ready" : "timeout");
			}

		} else if (strcmp(command, "exists") == 0) {
			puts(orb_exists(ORB_ID(orb_test), argument) == 0 ? "yes" : "no");

		} else {
			printf("no command %s\n", command);
		}
	}

	return 0;
}
