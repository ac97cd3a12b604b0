/*
 * Seed 002: a BeiDou and a GPS receiver publish the position, and who wants one
 * of the two subscribes to its instance. The page has pieces of it in its text;
 * this is the program. Mended:
 * - "struct position{ int xint yint z}": the page has lost its semicolons
 * - the advertises have a bracket too many, or a comma too few
 * - "publish" and "copy" are orb_publish and orb_copy
 * - the GPS receiver published beidou_position, its reader copied ORB_ID(speed)
 * - "sub" is sub_fd
 * - instances count from 0, and advertise says which one it is; the page has
 *   them numbered from 1, at the subscription
 *
 *     position beidou|gps [COUNT]
 *     position read INSTANCE [COUNT]
 */

#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <uORB/uORB.h>

struct position { int x; int y; int z; };

ORB_DECLARE(position);
ORB_DEFINE(position, struct position);

/* The BeiDou module of the page. */
static int beidou(int count)
{
	struct position beidou_position = {.x = 120, .y = 80, .z = -20};
	int instance_beidou;
	int pub_handle = orb_advertise_multi(ORB_ID(position), &beidou_position, &instance_beidou, 1);

	if (pub_handle < 0) {
		return 1;
	}

	printf("instance_beidou = %d\n", instance_beidou);

	while (--count != 0) {
		sleep(1);
		beidou_position.x++;
		orb_publish(ORB_ID(position), pub_handle, &beidou_position);
	}

	return 0;
}

/* The GPS module of the page. */
static int gps(int count)
{
	struct position gps_position = {.x = 90, .y = 110, .z = 10};
	int instance_gps;
	int pub_handle = orb_advertise_multi(ORB_ID(position), &gps_position, &instance_gps, 1);

	if (pub_handle < 0) {
		return 1;
	}

	printf("instance_gps = %d\n", instance_gps);

	while (--count != 0) {
		sleep(1);
		gps_position.y++;
		orb_publish(ORB_ID(position), pub_handle, &gps_position);
	}

	return 0;
}

/* Program A of the page. */
static int read_position(unsigned instance, int count)
{
	int sub_fd = orb_subscribe_multi(ORB_ID(position), instance);

	while (sub_fd >= 0 && count != 0) {
		struct pollfd fds[1] = {{.fd = sub_fd, .events = POLLIN}};
		struct position position;

		if (poll(fds, 1, -1) == 1 && orb_copy(ORB_ID(position), sub_fd, &position) == 0) {
			printf("instance %u: x %d, y %d, z %d\n", instance, position.x, position.y, position.z);
			count--;
		}
	}

	return orb_unsubscribe(sub_fd) == 0 ? 0 : 1;
}

int main(int argc, char *argv[])
{
	const char *role = argc > 1 ? argv[1] : "";
	/* Whoever reads it through a pipe sees a line when it is printed. */
	setvbuf(stdout, NULL, _IOLBF, 0);

	if (strcmp(role, "beidou") == 0) {
		return beidou(argc > 2 ? atoi(argv[2]) : 0);
	}

	if (strcmp(role, "gps") == 0) {
		return gps(argc > 2 ? atoi(argv[2]) : 0);
	}

	if (strcmp(role, "read") == 0 && argc > 2) {
		return read_position((unsigned)atoi(argv[2]), argc > 3 ? atoi(argv[3]) : -1);
	}

	fprintf(stderr, "usage: position beidou|gps [COUNT] | read INSTANCE [COUNT]\n");
	return 2;
}
