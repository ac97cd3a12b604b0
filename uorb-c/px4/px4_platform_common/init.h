/**
 * @file px4_platform_common/init.h
 *
 * Stands for PX4's header of this name: a task says its name when it starts.
 */

#ifndef UORB_PX4_INIT_H
#define UORB_PX4_INIT_H

#ifdef __cplusplus

#include <stdio.h>

#include <px4_platform_common/tasks.h>

namespace px4
{

inline void init(int, char *[], const char *process_name)
{
	printf("App name: %s\n", process_name);
	px4_prctl(PR_SET_NAME, process_name, px4_getpid());
}

} // namespace px4

#endif

#endif /* UORB_PX4_INIT_H */
