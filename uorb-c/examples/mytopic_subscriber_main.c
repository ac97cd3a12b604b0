/*
 * The program around mytopic_subscriber.c: looks ten times a second.
 *
 * In PX4 publisher and subscriber are one program and share one definition of
 * the topic. Here each program has its own; that they are the same is checked
 * when they meet.
 */

#include <stdio.h>
#include <unistd.h>
#include "mytopic.h"

ORB_DEFINE(random_integer);

void init();
void check_topic();

int main()
{
	/* Whoever reads it through a pipe sees a line when it is printed. */
	setvbuf(stdout, NULL, _IOLBF, 0);
	init();

	while (true) {
		check_topic();
		usleep(100 * 1000);
	}
}
