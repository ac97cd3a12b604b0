/**
 * @file px4_platform_common/tasks.h
 *
 * Stands for PX4's tasks. As in PX4 on Linux a task is a thread of the process,
 * not a process: tasks of one program share its memory and its handles.
 */

#ifndef UORB_PX4_TASKS_H
#define UORB_PX4_TASKS_H

#include <pthread.h>
#include <sched.h>
#include <stdbool.h>
#include <sys/prctl.h>

#include <visibility.h>

typedef int px4_task_t;

typedef int (*px4_main_t)(int argc, char *argv[]);

#define SCHED_DEFAULT SCHED_FIFO

#define SCHED_PRIORITY_MAX sched_get_priority_max(SCHED_FIFO)
#define SCHED_PRIORITY_MIN sched_get_priority_min(SCHED_FIFO)
#define SCHED_PRIORITY_DEFAULT ((SCHED_PRIORITY_MAX - SCHED_PRIORITY_MIN) / 2 + SCHED_PRIORITY_MIN)

/* Who should run before whom, in PX4's order. */
#define PX4_WQ_HP_BASE (SCHED_PRIORITY_MAX - 15)
#define SCHED_PRIORITY_FAST_DRIVER SCHED_PRIORITY_MAX
#define SCHED_PRIORITY_ACTUATOR_OUTPUTS (PX4_WQ_HP_BASE - 3)
#define SCHED_PRIORITY_ATTITUDE_CONTROL (PX4_WQ_HP_BASE - 4)
#define SCHED_PRIORITY_ESTIMATOR (PX4_WQ_HP_BASE - 5)
#define SCHED_PRIORITY_POSITION_CONTROL (PX4_WQ_HP_BASE - 7)
#define SCHED_PRIORITY_SLOW_DRIVER (PX4_WQ_HP_BASE - 35)
#define SCHED_PRIORITY_NAVIGATION (SCHED_PRIORITY_DEFAULT + 5)
#define SCHED_PRIORITY_LOG_WRITER (SCHED_PRIORITY_DEFAULT - 10)
#define SCHED_PRIORITY_PARAMS (SCHED_PRIORITY_DEFAULT - 15)

__BEGIN_DECLS

/**
 * Starts a task. Its argv[0] is its name, what is in argv follows; argv may be
 * NULL. The scheduler and the priority are applied where the process may
 * (CAP_SYS_NICE), the stack is at least as large as libuorb wants it.
 * Returns the task, 1 and up, or a negative errno.
 */
__EXPORT extern px4_task_t px4_task_spawn_cmd(const char *name, int scheduler, int priority, int stack_size,
		px4_main_t entry, char *const argv[]);

/** Ends the task that calls it at once, another one in its next px4_usleep or
 * px4_sleep, or after its next px4_poll: nowhere within the library, which would
 * not survive it. What it holds is not given back. 0, or a negative errno. */
__EXPORT extern int px4_task_delete(px4_task_t task);

/** Sends a signal to a task. 0, or a negative errno. */
__EXPORT extern int px4_task_kill(px4_task_t task, int signal);

/** Ends the task that calls it. The program's own waits for the others first,
 * and ends the process. */
__EXPORT extern void px4_task_exit(int result) __attribute__((noreturn));

/** Prints the tasks that run. */
__EXPORT extern void px4_show_tasks(void);

/** Whether a task of this name runs. */
__EXPORT extern bool px4_task_is_running(const char *name);

/** The name of the task that calls it. */
__EXPORT extern const char *px4_get_taskname(void);

/** PR_SET_NAME names a task's thread; there are no other options. */
__EXPORT extern int px4_prctl(int option, const char *name, px4_task_t task);

/** The task that calls it: 0 in the program's own thread. */
__EXPORT extern px4_task_t px4_getpid(void);

/** Not in PX4. Ends the task that calls it here, if it was deleted. */
__EXPORT extern void px4_task_may_end(void);

/** Not in PX4. Waits until all tasks have ended: what px4_main.c ends with. */
__EXPORT extern void px4_wait_for_tasks(void);

__END_DECLS

#endif /* UORB_PX4_TASKS_H */
