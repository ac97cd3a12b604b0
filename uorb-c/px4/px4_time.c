/**
 * @file px4_time.c
 *
 * The time.
 */

#define _GNU_SOURCE

#include <drivers/drv_hrt.h>

hrt_abstime hrt_absolute_time(void)
{
	struct timespec now;
	clock_gettime(CLOCK_MONOTONIC, &now);
	return ts_to_abstime(&now);
}

hrt_abstime hrt_store_absolute_time(volatile hrt_abstime *time)
{
	const hrt_abstime now = hrt_absolute_time();
	/* One instruction, so that a signal finds the old time or the new one. */
	__atomic_store_n(time, now, __ATOMIC_RELAXED);
	return now;
}
