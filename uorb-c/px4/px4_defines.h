/**
 * @file px4_defines.h
 *
 * The name that px4_platform_common/defines.h had from 2015 to 2019.
 */

#ifndef UORB_PX4_OLD_DEFINES_H
#define UORB_PX4_OLD_DEFINES_H

#include <px4_platform_common/defines.h>

#endif /* UORB_PX4_OLD_DEFINES_H */
