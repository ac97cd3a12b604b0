/**
 * @file systemlib/systemlib.h
 *
 * Stands for PX4's header of this name (to 2018), for what it brings along,
 * and the name that px4_task_spawn_cmd had to 2015.
 */

#ifndef UORB_PX4_SYSTEMLIB_H
#define UORB_PX4_SYSTEMLIB_H

#include <float.h>
#include <stdint.h>

#include <px4_platform_common/tasks.h>

#define task_spawn_cmd px4_task_spawn_cmd

#endif /* UORB_PX4_SYSTEMLIB_H */
