/**
 * @file px4_log.c
 *
 * Lines of the log. Each is written in one piece, so that those of several tasks
 * do not mix.
 */

#include <stdio.h>
#include <unistd.h>

#include <px4_platform_common/log.h>

/* As long as a log_message of PX4 may be, and a piece of what says who speaks. */
#define LINE_BYTES 256

static const char *const LEVELS[] = {"DEBUG", "INFO", "WARN", "ERROR", "PANIC"};
static const char *const COLOURS[] = {"\033[32m", "\033[0m", "\033[33m", "\033[31m", "\033[31m"};
static const char *const GREY = "\033[90m";
static const char *const NO_COLOUR = "\033[0m";

void px4_log_modulename(int level, const char *module_name, const char *format, ...)
{
	char text[LINE_BYTES];
	va_list arguments;
	va_start(arguments, format);
	vsnprintf(text, sizeof(text), format, arguments);
	va_end(arguments);

	if (isatty(STDOUT_FILENO)) {
		printf("%s%-5s %s[%s]%s %s%s\n", COLOURS[level], LEVELS[level], GREY, module_name, COLOURS[level],
		       text, NO_COLOUR);

	} else {
		printf("%-5s [%s] %s\n", LEVELS[level], module_name, text);
	}
}

void px4_log_raw(int level, const char *format, ...)
{
	(void)level;
	va_list arguments;
	va_start(arguments, format);
	vprintf(format, arguments);
	va_end(arguments);
}
