/**
 * @file px4_init.h
 *
 * The name that px4_platform_common/init.h had in 2019.
 */

#ifndef UORB_PX4_OLD_INIT_H
#define UORB_PX4_OLD_INIT_H

#include <px4_platform_common/init.h>

#endif /* UORB_PX4_OLD_INIT_H */
