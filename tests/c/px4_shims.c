/* What PX4's own functions do for a module: tasks, log, time, options. A module
 * itself, run by px4_main.c. */

#include <nuttx/config.h>
#include <px4_platform_common/getopt.h>
#include <px4_platform_common/log.h>
#include <px4_platform_common/posix.h>
#include <px4_platform_common/tasks.h>
#include <px4_platform_common/time.h>
#include <systemlib/err.h>

#include <drivers/drv_hrt.h>
#include <uORB/topics/orb_test.h>

#include "check.h"

__EXPORT int px4_shims_main(int argc, char *argv[]);

static volatile int stage;

/* Waits for what another task does. */
static void until(int reached)
{
	const hrt_abstime start = hrt_absolute_time();

	while (stage < reached) {
		CHECK(hrt_elapsed_time(&start) < PATIENCE_US);
		px4_usleep(100);
	}
}

static int has_arguments(int argc, char *argv[])
{
	CHECK_EQUAL(argc, 3);
	CHECK(strcmp(argv[0], "a task with a long name") == 0);
	CHECK(strcmp(argv[1], "start") == 0);
	CHECK(strcmp(argv[2], "-p 1") == 0);
	CHECK(argv[3] == NULL);
	/* What the kernel keeps of it. */
	CHECK(strcmp(px4_get_taskname(), "a task with a l") == 0);
	CHECK(px4_getpid() >= 1);
	stage = 1;
	return 0;
}

static int exits(int argc, char *argv[])
{
	(void)argv;
	CHECK_EQUAL(argc, 1);
	stage = 2;
	px4_task_exit(3);
}

static int polls_for_ever(int argc, char *argv[])
{
	(void)argc;
	(void)argv;
	px4_pollfd_struct_t fd = {.fd = orb_subscribe(ORB_ID(orb_test)), .events = POLLIN};
	CHECK(fd.fd >= 0);
	stage = 3;

	while (true) {
		px4_poll(&fd, 1, 10);
	}

	return 0;
}

static int sleeps_for_ever(int argc, char *argv[])
{
	(void)argc;
	(void)argv;
	stage = 4;

	while (true) {
		px4_sleep(1000);
	}

	return 0;
}

static int ends_last(int argc, char *argv[])
{
	(void)argc;
	(void)argv;
	/* The module has ended by now, or is about to: the program waits for us. */
	px4_usleep(20 * 1000);
	PX4_INFO("the last task ends");
	return 0;
}

static px4_task_t spawn(const char *name, px4_main_t entry, char *const argv[])
{
	const px4_task_t task = px4_task_spawn_cmd(name, SCHED_DEFAULT, SCHED_PRIORITY_DEFAULT, 2000, entry, argv);
	CHECK(task > 0);
	return task;
}

static void tasks_run_and_end(void)
{
	char *const arguments[] = {"start", "-p 1", NULL};
	CHECK_EQUAL(px4_getpid(), 0);
	spawn("a task with a long name", has_arguments, arguments);
	until(1);
	spawn("exits", exits, NULL);
	until(2);
	px4_wait_for_tasks();
	CHECK(!px4_task_is_running("exits"));

	const px4_task_t polls = spawn("polls", polls_for_ever, NULL);
	until(3);
	CHECK(px4_task_is_running("polls"));
	CHECK_EQUAL(px4_task_kill(polls, 0), 0);
	CHECK_EQUAL(px4_prctl(PR_SET_NAME, "polls on", polls), 0);
	CHECK_EQUAL(px4_task_delete(polls), 0);
	const px4_task_t sleeps = spawn("sleeps", sleeps_for_ever, NULL);
	until(4);
	CHECK_EQUAL(px4_task_delete(sleeps), 0);
	px4_wait_for_tasks();
	CHECK(!px4_task_is_running("polls") && !px4_task_is_running("sleeps"));
	CHECK_EQUAL(px4_task_delete(polls), -EINVAL);
	CHECK_EQUAL(px4_task_kill(99, 0), -EINVAL);

	/* Fifty at a time, and no more. */
	px4_task_t all[50];

	for (int i = 0; i < 50; i++) {
		all[i] = spawn("one of fifty", sleeps_for_ever, NULL);
	}

	CHECK_EQUAL(px4_task_spawn_cmd("too many", SCHED_DEFAULT, SCHED_PRIORITY_MAX, 0, sleeps_for_ever, NULL), -ENOSPC);

	for (int i = 0; i < 50; i++) {
		CHECK_EQUAL(px4_task_delete(all[i]), 0);
	}

	px4_wait_for_tasks();
	px4_show_tasks();
}

static void options_come_in_any_order(void)
{
	char texts[][8] = {"app", "start", "-a", "-b", "value", "more", "-x", "-b"};
	char *argv[9] = {NULL};

	for (int i = 0; i < 8; i++) {
		argv[i] = texts[i];
	}

	int index = 1;
	const char *value = NULL;
	CHECK_EQUAL(px4_getopt(8, argv, "ab:", &index, &value), 'a');
	CHECK_EQUAL(px4_getopt(8, argv, "ab:", &index, &value), 'b');
	CHECK(strcmp(value, "value") == 0);
	CHECK_EQUAL(px4_getopt(8, argv, "ab:", &index, &value), '?');
	/* -b without its argument. */
	CHECK_EQUAL(px4_getopt(8, argv, "ab:", &index, &value), '?');
	CHECK_EQUAL(px4_getopt(8, argv, "ab:", &index, &value), -1);
	/* What is no option has moved behind them. */
	CHECK_EQUAL(index, 6);
	CHECK(strcmp(argv[6], "start") == 0 && strcmp(argv[7], "more") == 0 && argv[8] == NULL);
}

static void time_passes(void)
{
	const hrt_abstime start = hrt_absolute_time();
	struct timespec now;
	clock_gettime(CLOCK_MONOTONIC, &now);
	CHECK(ts_to_abstime(&now) >= start);
	CHECK_EQUAL(px4_usleep(2000), 0);
	CHECK(hrt_elapsed_time(&start) >= 2000);
	volatile hrt_abstime stored;
	CHECK(hrt_store_absolute_time(&stored) == stored && stored > start);
	abstime_to_ts(&now, 1234567);
	CHECK(now.tv_sec == 1 && now.tv_nsec == 234567000);
	CHECK(PX4_ISFINITE(1.0f) && !PX4_ISFINITE(1.0f / 0.0f));
}

int px4_shims_main(int argc, char *argv[])
{
	CHECK(argc == 2);
	PX4_INFO("%s", argv[1]);
	PX4_WARN("a warning");
	PX4_ERR("an error: %d", 7);
	PX4_PANIC("panic");
	PX4_DEBUG("nobody sees %s", "this");
	PX4_INFO_RAW("raw\n");
	warnx("warnx");
	options_come_in_any_order();
	time_passes();
	tasks_run_and_end();
	spawn("last", ends_last, NULL);
	errno = ENOENT;
	err(4, "err");
	return ERROR;
}
