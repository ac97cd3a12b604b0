/**
 * @file px4_config.h
 *
 * The name that px4_platform_common/px4_config.h had from 2015 to 2019.
 */

#ifndef UORB_PX4_OLD_CONFIG_H
#define UORB_PX4_OLD_CONFIG_H

#include <px4_platform_common/px4_config.h>

#endif /* UORB_PX4_OLD_CONFIG_H */
