/**
 * @file px4_platform_common/log.h
 *
 * Stands for PX4's log: `INFO  [px4_simple_app] Hello Sky!`, one line a call, on
 * stdout, in colour on a terminal. Nothing is published.
 *
 * MODULE_NAME says who speaks, as PX4's build does (-DMODULE_NAME='"sensors"');
 * a program that is built with px4_main.c has its name from PX4_MAIN.
 */

#ifndef UORB_PX4_LOG_H
#define UORB_PX4_LOG_H

#include <inttypes.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>

#include <drivers/drv_hrt.h>
#include <px4_platform_common/defines.h>

#ifndef MODULE_NAME
# ifdef PX4_MAIN
#  define UORB_PX4_QUOTED(_name) #_name
#  define UORB_PX4_EXPANDED(_name) UORB_PX4_QUOTED(_name)
#  define MODULE_NAME UORB_PX4_EXPANDED(PX4_MAIN)
# else
#  define MODULE_NAME "Unknown"
# endif
#endif

#define _PX4_LOG_LEVEL_DEBUG 0
#define _PX4_LOG_LEVEL_INFO 1
#define _PX4_LOG_LEVEL_WARN 2
#define _PX4_LOG_LEVEL_ERROR 3
#define _PX4_LOG_LEVEL_PANIC 4

__BEGIN_DECLS

/** One line: level, module, text. */
__EXPORT extern void px4_log_modulename(int level, const char *module_name, const char *format, ...)
	__attribute__((format(printf, 3, 4)));

/** The text alone, without a new line. */
__EXPORT extern void px4_log_raw(int level, const char *format, ...) __attribute__((format(printf, 2, 3)));

__END_DECLS

/* An empty line is a line: PX4_INFO(""). */
#pragma GCC diagnostic ignored "-Wformat-zero-length"

#define PX4_INFO(...) px4_log_modulename(_PX4_LOG_LEVEL_INFO, MODULE_NAME, __VA_ARGS__)
#define PX4_WARN(...) px4_log_modulename(_PX4_LOG_LEVEL_WARN, MODULE_NAME, __VA_ARGS__)
#define PX4_ERR(...) px4_log_modulename(_PX4_LOG_LEVEL_ERROR, MODULE_NAME, __VA_ARGS__)
#define PX4_PANIC(...) px4_log_modulename(_PX4_LOG_LEVEL_PANIC, MODULE_NAME, __VA_ARGS__)
#define PX4_INFO_RAW(...) px4_log_raw(_PX4_LOG_LEVEL_INFO, __VA_ARGS__)

/* Only in a build that asks for it; the compiler reads it in any. */
#if defined(DEBUG_BUILD) || defined(TRACE_BUILD)
# define PX4_DEBUG(...) px4_log_modulename(_PX4_LOG_LEVEL_DEBUG, MODULE_NAME, __VA_ARGS__)
#else
# define PX4_DEBUG(...) \
	do { \
		if (0) { px4_log_modulename(_PX4_LOG_LEVEL_DEBUG, MODULE_NAME, __VA_ARGS__); } \
	} while (0)
#endif

#endif /* UORB_PX4_LOG_H */
