/**
 * @file px4_platform_common/time.h
 *
 * Stands for PX4's header of this name. In PX4's simulation these follow the
 * simulated time; here time is time.
 */

#ifndef UORB_PX4_TIME_H
#define UORB_PX4_TIME_H

#include <pthread.h>
#include <stdint.h>
#include <sys/types.h>
#include <time.h>
#include <unistd.h>

#include <visibility.h>

#define px4_clock_gettime clock_gettime
#define px4_clock_settime clock_settime
#define px4_pthread_cond_timedwait pthread_cond_timedwait

__BEGIN_DECLS

/** Sleeps for so many microseconds, any number. -1 if a signal came. */
__EXPORT extern int px4_usleep(uint32_t time_us);

/** Sleeps for so many seconds. Returns how many were left when a signal came. */
__EXPORT extern unsigned px4_sleep(unsigned seconds);

__END_DECLS

#endif /* UORB_PX4_TIME_H */
