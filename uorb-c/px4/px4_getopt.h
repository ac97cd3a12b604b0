/**
 * @file px4_getopt.h
 *
 * The name that px4_platform_common/getopt.h had from 2015 to 2019.
 */

#ifndef UORB_PX4_OLD_GETOPT_H
#define UORB_PX4_OLD_GETOPT_H

#include <px4_platform_common/getopt.h>

#endif /* UORB_PX4_OLD_GETOPT_H */
