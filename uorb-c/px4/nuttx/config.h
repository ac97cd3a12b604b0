/**
 * @file nuttx/config.h
 *
 * Stands for NuttX's configuration, which programs of 2012 to 2016 include
 * first. Here nothing is configured, but they count on what NuttX's headers and
 * PX4's build bring along: OK and ERROR, true and false, memset.
 */

#ifndef UORB_PX4_NUTTX_CONFIG_H
#define UORB_PX4_NUTTX_CONFIG_H

#include <px4_platform_common/px4_config.h>

#endif /* UORB_PX4_NUTTX_CONFIG_H */
