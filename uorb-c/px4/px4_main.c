/**
 * @file px4_main.c
 *
 * Makes a program of a PX4 module: what starts a module in PX4 is its shell.
 *
 *     cc -DPX4_MAIN=px4_simple_app px4_simple_app.c px4_main.c ...
 *
 * runs px4_simple_app_main, waits for the tasks that it has started, and exits
 * with what it returned.
 */

#include <stdio.h>

#include <px4_platform_common/tasks.h>

#ifndef PX4_MAIN
# error "say which module this is: -DPX4_MAIN=px4_simple_app"
#endif

#define UORB_PX4_JOINED(_name, _end) _name##_end
#define UORB_PX4_MAIN_OF(_name) UORB_PX4_JOINED(_name, _main)
#define UORB_PX4_ENTRY UORB_PX4_MAIN_OF(PX4_MAIN)

int UORB_PX4_ENTRY(int argc, char *argv[]);

int main(int argc, char *argv[])
{
	/* Whoever reads it through a pipe sees a line when it is printed. */
	setvbuf(stdout, NULL, _IOLBF, 0);
	const int result = UORB_PX4_ENTRY(argc, argv);
	px4_wait_for_tasks();
	return result;
}
