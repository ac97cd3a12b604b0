/**
 * @file px4_getopt.c
 *
 * getopt without a state of its own. Options are single letters, each an
 * argument of its own; one with a ':' behind it in `options` takes the next
 * argument.
 */

#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#include <px4_platform_common/getopt.h>

static bool is_option(const char *argument)
{
	return argument[0] == '-' && argument[1] != '\0';
}

/* Where the option of this argument stands in `options`; NULL if it is unknown. */
static const char *find_option(const char *argument, const char *options)
{
	return argument[1] == ':' ? NULL : strchr(options, argument[1]);
}

/* Moves argv[from] to argv[to], which is before it, and those in between up. */
static void move_down(char *argv[], int from, int to)
{
	char *moved = argv[from];
	memmove(&argv[to + 1], &argv[to], (size_t)(from - to) * sizeof(argv[0]));
	argv[to] = moved;
}

int px4_getopt(int argc, char *argv[], const char *options, int *myoptind, const char **myoptarg)
{
	int next = *myoptind;

	while (next < argc && argv[next] != NULL && !is_option(argv[next])) {
		next++;
	}

	if (next >= argc || argv[next] == NULL) {
		return -1;
	}

	const char *option = find_option(argv[next], options);
	const bool takes_argument = option != NULL && option[1] == ':';
	move_down(argv, next, *myoptind);
	*myoptind += 1;

	if (option == NULL) {
		return '?';
	}

	if (takes_argument) {
		if (next + 1 >= argc || argv[next + 1] == NULL) {
			return '?';
		}

		move_down(argv, next + 1, *myoptind);
		*myoptarg = argv[*myoptind];
		*myoptind += 1;
	}

	return *option;
}
