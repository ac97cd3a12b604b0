/**
 * @file px4_middleware.h
 *
 * The name that px4_platform_common/init.h had from 2015 to 2018.
 */

#ifndef UORB_PX4_OLD_MIDDLEWARE_H
#define UORB_PX4_OLD_MIDDLEWARE_H

#include <px4_platform_common/init.h>

#endif /* UORB_PX4_OLD_MIDDLEWARE_H */
