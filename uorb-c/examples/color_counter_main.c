/*
 * The program around color_counter.c. The seed defines only the topic that it
 * publishes: in PX4 the colours are defined by who publishes them, in the same
 * program. Here that is another process, color_publisher.
 */

#include <stdio.h>
#include "color_counter.h"

ORB_DEFINE(color_red, struct color_update);
ORB_DEFINE(color_green, struct color_update);
ORB_DEFINE(color_blue, struct color_update);

void subscriber(void);

int main(void)
{
	/* Whoever reads it through a pipe sees a line when it is printed. */
	setvbuf(stdout, NULL, _IOLBF, 0);
	subscriber();
}
