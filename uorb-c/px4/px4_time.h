/**
 * @file px4_time.h
 *
 * The name that px4_platform_common/time.h had from 2015 to 2019.
 */

#ifndef UORB_PX4_OLD_TIME_H
#define UORB_PX4_OLD_TIME_H

#include <px4_platform_common/time.h>

#endif /* UORB_PX4_OLD_TIME_H */
