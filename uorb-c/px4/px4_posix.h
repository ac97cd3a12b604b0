/**
 * @file px4_posix.h
 *
 * The name that px4_platform_common/posix.h had from 2015 to 2019.
 */

#ifndef UORB_PX4_OLD_POSIX_H
#define UORB_PX4_OLD_POSIX_H

#include <px4_platform_common/posix.h>

#endif /* UORB_PX4_OLD_POSIX_H */
