/**
 * @file px4_time.c
 *
 * The time, and sleep.
 */

#define _GNU_SOURCE

#include <errno.h>

#include <drivers/drv_hrt.h>
#include <px4_platform_common/time.h>

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

int px4_usleep(uint32_t time_us)
{
	/* usleep(3) may refuse a second and more. */
	struct timespec time;
	abstime_to_ts(&time, time_us);
	return nanosleep(&time, NULL);
}

unsigned px4_sleep(unsigned seconds)
{
	return sleep(seconds);
}
