/**
 * @file systemlib/systemlib.h
 *
 * Stands for PX4's header of this name (to 2018), for what it brings along.
 */

#ifndef UORB_PX4_SYSTEMLIB_H
#define UORB_PX4_SYSTEMLIB_H

#include <float.h>
#include <stdint.h>

#include <px4_platform_common/tasks.h>

#endif /* UORB_PX4_SYSTEMLIB_H */
