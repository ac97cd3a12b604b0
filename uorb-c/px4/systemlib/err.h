/**
 * @file systemlib/err.h
 *
 * Stands for PX4's header of this name: warnings, and errors that end the task.
 */

#ifndef UORB_PX4_SYSTEMLIB_ERR_H
#define UORB_PX4_SYSTEMLIB_ERR_H

#include <errno.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <px4_platform_common/log.h>
#include <px4_platform_common/tasks.h>

#define EXIT(_result) px4_task_exit(_result)

#define warn(...) PX4_WARN(__VA_ARGS__)
#define warnx(...) PX4_WARN(__VA_ARGS__)

#define errx(_result, ...) \
	do { \
		PX4_ERR(__VA_ARGS__); \
		EXIT(_result); \
	} while (0)

/* errno is read first: to print may change it. */
#define err(_result, ...) \
	do { \
		const int _err_number = errno; \
		PX4_ERR(__VA_ARGS__); \
		PX4_ERR("Task exited with errno=%i (%s)", _err_number, strerror(_err_number)); \
		EXIT(_result); \
	} while (0)

#endif /* UORB_PX4_SYSTEMLIB_ERR_H */
