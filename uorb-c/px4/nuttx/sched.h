/**
 * @file nuttx/sched.h
 *
 * Stands for NuttX's tasks, which programs to 2015 include before PX4's.
 */

#ifndef UORB_PX4_NUTTX_SCHED_H
#define UORB_PX4_NUTTX_SCHED_H

#include <px4_platform_common/tasks.h>

#endif /* UORB_PX4_NUTTX_SCHED_H */
