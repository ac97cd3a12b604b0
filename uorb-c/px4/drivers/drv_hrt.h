/**
 * @file drivers/drv_hrt.h
 *
 * Stands for PX4's high resolution timer: the time in microseconds. It is
 * CLOCK_MONOTONIC, the clock of all processes and of all messages' timestamps.
 * There are no callouts (hrt_call_every and its like).
 */

#ifndef UORB_PX4_DRV_HRT_H
#define UORB_PX4_DRV_HRT_H

#include <inttypes.h>
#include <stdbool.h>
#include <stdint.h>
#include <sys/types.h>
#include <time.h>

#include <px4_platform_common/time.h>

/** A time in microseconds since the system started, or a difference of two. */
typedef uint64_t hrt_abstime;

__BEGIN_DECLS

/** The time. */
__EXPORT extern hrt_abstime hrt_absolute_time(void);

/** Stores the time in one piece, for an interrupt or a signal handler to read,
 * and returns it. */
__EXPORT extern hrt_abstime hrt_store_absolute_time(volatile hrt_abstime *time);

/** How long it has been since then. */
static inline hrt_abstime hrt_elapsed_time(const volatile hrt_abstime *then)
{
	return hrt_absolute_time() - *then;
}

static inline hrt_abstime ts_to_abstime(const struct timespec *ts)
{
	return (hrt_abstime)ts->tv_sec * 1000000 + (hrt_abstime)ts->tv_nsec / 1000;
}

static inline void abstime_to_ts(struct timespec *ts, hrt_abstime time)
{
	ts->tv_sec = (time_t)(time / 1000000);
	ts->tv_nsec = (long)(time % 1000000 * 1000);
}

__END_DECLS

#ifdef __cplusplus

/** 10_ms is 10,000. */
namespace time_literals
{

constexpr hrt_abstime operator""_s(unsigned long long seconds) { return seconds * 1000000; }
constexpr hrt_abstime operator""_ms(unsigned long long milliseconds) { return milliseconds * 1000; }
constexpr hrt_abstime operator""_us(unsigned long long microseconds) { return microseconds; }

} // namespace time_literals

#endif

#endif /* UORB_PX4_DRV_HRT_H */
