/**
 * @file px4_tasks.c
 *
 * Tasks as threads. A table says which there are; a task leaves it as the last
 * thing it does, however it ends: by returning, by px4_task_exit or deleted.
 *
 * To be deleted is to be cancelled (pthreads(7)), which unwinds the stack. Rust
 * cannot be unwound like that, and poll(2) within libuorb is a place where it
 * would happen; so tasks cannot be cancelled but where they say that they can.
 */

#define _GNU_SOURCE
#define MODULE_NAME "px4"

#include <errno.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <drivers/drv_hrt.h>
#include <px4_platform_common/log.h>
#include <px4_platform_common/tasks.h>

#define TASKS_MAX 50

/* With the NUL, what the kernel keeps of a thread's name. */
#define NAME_BYTES 16

/* PX4's sizes are those of frames on NuttX. printf with floating point and the
 * calls of libuorb want more; what is not touched costs nothing. */
#define STACK_MIN_BYTES (256 * 1024)

/* What a new thread is told: the arguments and their texts in one piece. */
struct start {
	struct task *task;
	px4_main_t entry;
	int argc;
	char *argv[];
};

struct task {
	bool runs;
	pthread_t thread;
	char name[NAME_BYTES];
};

/* The program's own thread is task 0 and is not in the table. */
static struct task tasks[TASKS_MAX];
static pthread_mutex_t tasks_lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t a_task_has_ended = PTHREAD_COND_INITIALIZER;

static _Thread_local struct task *this_task;

/* The task of this number, if it runs. The table is locked. */
static struct task *running(px4_task_t number)
{
	const bool is_one = number >= 1 && number <= TASKS_MAX && tasks[number - 1].runs;
	return is_one ? &tasks[number - 1] : NULL;
}

static void leave(void *start)
{
	struct task *task = ((struct start *)start)->task;
	free(start);
	pthread_mutex_lock(&tasks_lock);
	task->runs = false;
	pthread_cond_broadcast(&a_task_has_ended);
	pthread_mutex_unlock(&tasks_lock);
}

static void *run(void *argument)
{
	struct start *start = argument;
	this_task = start->task;
	pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, NULL);
	pthread_setname_np(pthread_self(), start->task->name);
	pthread_cleanup_push(leave, start);
	start->entry(start->argc, start->argv);
	pthread_cleanup_pop(true);
	return NULL;
}

/* The name, then the arguments, then their texts. NULL: no memory. */
static struct start *new_start(const char *name, px4_main_t entry, char *const argv[])
{
	int given = 0;
	size_t text_bytes = strlen(name) + 1;

	while (argv != NULL && argv[given] != NULL) {
		text_bytes += strlen(argv[given]) + 1;
		given++;
	}

	const int argc = given + 1;
	const size_t table_bytes = (size_t)(argc + 1) * sizeof(char *);
	struct start *start = malloc(sizeof(*start) + table_bytes + text_bytes);

	if (start == NULL) {
		return NULL;
	}

	start->entry = entry;
	start->argc = argc;
	char *text = (char *)start->argv + table_bytes;

	for (int i = 0; i < argc; i++) {
		start->argv[i] = text;
		text = stpcpy(text, i == 0 ? name : argv[i - 1]) + 1;
	}

	start->argv[argc] = NULL;
	return start;
}

/* Starts the thread, with the scheduler if the process may. An errno. */
static int new_thread(pthread_t *thread, int scheduler, int priority, int stack_size, struct start *start)
{
	const size_t asked = stack_size < 0 ? 0 : (size_t)stack_size;
	const struct sched_param parameters = {.sched_priority = priority};
	pthread_attr_t attributes;
	pthread_attr_init(&attributes);
	pthread_attr_setdetachstate(&attributes, PTHREAD_CREATE_DETACHED);
	pthread_attr_setstacksize(&attributes, asked < STACK_MIN_BYTES ? STACK_MIN_BYTES : asked);
	pthread_attr_setinheritsched(&attributes, PTHREAD_EXPLICIT_SCHED);
	pthread_attr_setschedpolicy(&attributes, scheduler);
	pthread_attr_setschedparam(&attributes, &parameters);
	int failed = pthread_create(thread, &attributes, run, start);

	if (failed == EPERM) {
		pthread_attr_setinheritsched(&attributes, PTHREAD_INHERIT_SCHED);
		failed = pthread_create(thread, &attributes, run, start);
	}

	pthread_attr_destroy(&attributes);
	return failed;
}

px4_task_t px4_task_spawn_cmd(const char *name, int scheduler, int priority, int stack_size, px4_main_t entry,
			      char *const argv[])
{
	struct start *start = new_start(name, entry, argv);

	if (start == NULL) {
		return -ENOMEM;
	}

	pthread_mutex_lock(&tasks_lock);
	int index = 0;

	while (index < TASKS_MAX && tasks[index].runs) {
		index++;
	}

	int failed = ENOSPC;

	if (index < TASKS_MAX) {
		struct task *task = &tasks[index];
		start->task = task;
		strncpy(task->name, name, NAME_BYTES - 1);
		/* The thread leaves the table only after this lock is given back. */
		failed = new_thread(&task->thread, scheduler, priority, stack_size, start);
		task->runs = failed == 0;
	}

	pthread_mutex_unlock(&tasks_lock);

	if (failed != 0) {
		free(start);
		return -failed;
	}

	return index + 1;
}

int px4_task_delete(px4_task_t number)
{
	if (number == px4_getpid()) {
		px4_task_exit(0);
	}

	pthread_mutex_lock(&tasks_lock);
	struct task *task = running(number);
	const int failed = task == NULL ? EINVAL : pthread_cancel(task->thread);
	pthread_mutex_unlock(&tasks_lock);
	return -failed;
}

int px4_task_kill(px4_task_t number, int signal)
{
	pthread_mutex_lock(&tasks_lock);
	struct task *task = running(number);
	const int failed = task == NULL ? EINVAL : pthread_kill(task->thread, signal);
	pthread_mutex_unlock(&tasks_lock);
	return -failed;
}

void px4_task_exit(int result)
{
	if (this_task == NULL) {
		px4_wait_for_tasks();
		exit(result);
	}

	pthread_exit(NULL);
}

void px4_task_may_end(void)
{
	if (this_task != NULL) {
		pthread_setcancelstate(PTHREAD_CANCEL_ENABLE, NULL);
		pthread_testcancel();
		pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, NULL);
	}
}

int px4_usleep(uint32_t time_us)
{
	/* usleep(3) may refuse a second and more. */
	struct timespec time;
	abstime_to_ts(&time, time_us);
	int state;
	pthread_setcancelstate(PTHREAD_CANCEL_ENABLE, &state);
	const int slept = nanosleep(&time, NULL);
	pthread_setcancelstate(state, NULL);
	return slept;
}

unsigned px4_sleep(unsigned seconds)
{
	int state;
	pthread_setcancelstate(PTHREAD_CANCEL_ENABLE, &state);
	const unsigned left = sleep(seconds);
	pthread_setcancelstate(state, NULL);
	return left;
}

void px4_wait_for_tasks(void)
{
	pthread_mutex_lock(&tasks_lock);

	for (int i = 0; i < TASKS_MAX; i++) {
		/* One that ended may have started others, before it in the table. */
		while (tasks[i].runs) {
			pthread_cond_wait(&a_task_has_ended, &tasks_lock);
			i = 0;
		}
	}

	pthread_mutex_unlock(&tasks_lock);
}

void px4_show_tasks(void)
{
	int count = 0;
	PX4_INFO("Active Tasks:");
	pthread_mutex_lock(&tasks_lock);

	for (int i = 0; i < TASKS_MAX; i++) {
		if (tasks[i].runs) {
			PX4_INFO("   %-15s %d", tasks[i].name, i + 1);
			count++;
		}
	}

	pthread_mutex_unlock(&tasks_lock);

	if (count == 0) {
		PX4_INFO("   No running tasks");
	}
}

bool px4_task_is_running(const char *name)
{
	bool runs = false;
	pthread_mutex_lock(&tasks_lock);

	for (int i = 0; i < TASKS_MAX; i++) {
		runs |= tasks[i].runs && strncmp(tasks[i].name, name, NAME_BYTES - 1) == 0;
	}

	pthread_mutex_unlock(&tasks_lock);
	return runs;
}

const char *px4_get_taskname(void)
{
	return this_task == NULL ? program_invocation_short_name : this_task->name;
}

int px4_prctl(int option, const char *name, px4_task_t number)
{
	if (option != PR_SET_NAME) {
		return -EINVAL;
	}

	pthread_mutex_lock(&tasks_lock);
	struct task *task = running(number);
	const bool is_own = number == px4_getpid();
	int failed = EINVAL;

	if (task != NULL || is_own) {
		char short_name[NAME_BYTES] = "";
		strncpy(short_name, name, NAME_BYTES - 1);
		failed = pthread_setname_np(is_own ? pthread_self() : task->thread, short_name);
	}

	pthread_mutex_unlock(&tasks_lock);
	return -failed;
}

px4_task_t px4_getpid(void)
{
	return this_task == NULL ? 0 : (px4_task_t)(this_task - tasks) + 1;
}
