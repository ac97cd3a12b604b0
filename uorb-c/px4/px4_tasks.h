/**
 * @file px4_tasks.h
 *
 * The name that px4_platform_common/tasks.h had from 2015 to 2019.
 */

#ifndef UORB_PX4_OLD_TASKS_H
#define UORB_PX4_OLD_TASKS_H

#include <px4_platform_common/tasks.h>

#endif /* UORB_PX4_OLD_TASKS_H */
