/*
 * What the seed 001 has another module do: publishes one colour, counting up,
 * once a second.
 *
 *     color_publisher red|green|blue [COUNT]
 */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "color_counter.h"

ORB_DEFINE(color_red, struct color_update);
ORB_DEFINE(color_green, struct color_update);
ORB_DEFINE(color_blue, struct color_update);

static orb_id_t color_topic(const char *color)
{
	if (strcmp(color, "red") == 0) {
		return ORB_ID(color_red);
	}

	if (strcmp(color, "green") == 0) {
		return ORB_ID(color_green);
	}

	return strcmp(color, "blue") == 0 ? ORB_ID(color_blue) : NULL;
}

int main(int argc, char *argv[])
{
	orb_id_t topic = argc > 1 ? color_topic(argv[1]) : NULL;
	const int count = argc > 2 ? atoi(argv[2]) : -1;

	if (topic == NULL) {
		fprintf(stderr, "usage: color_publisher red|green|blue [COUNT]\n");
		return 2;
	}

	struct color_update update = {.number = 1};
	const int publication = orb_advertise(topic, &update);

	if (publication < 0) {
		return 1;
	}

	while (update.number != count) {
		sleep(1);
		update.number++;
		orb_publish(topic, publication, &update);
	}

	return orb_unadvertise(publication) == 0 ? 0 : 1;
}
