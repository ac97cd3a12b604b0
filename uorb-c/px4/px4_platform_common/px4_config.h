/**
 * @file px4_platform_common/px4_config.h
 *
 * Stands for PX4's configuration of the build and of the board, of which there
 * is none here. Brings along what programs count on.
 */

#ifndef UORB_PX4_CONFIG_H
#define UORB_PX4_CONFIG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>

#include <px4_platform_common/defines.h>

#endif /* UORB_PX4_CONFIG_H */
