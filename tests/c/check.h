/* What the test programs in C and C++ check with: a condition that does not hold
 * is said with its place, and ends the program. */

#ifndef UORB_TESTS_CHECK_H
#define UORB_TESTS_CHECK_H

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(_condition) \
	do { \
		if (!(_condition)) { \
			fprintf(stderr, "%s:%d: not true: %s (errno %s)\n", __FILE__, __LINE__, #_condition, \
				strerror(errno)); \
			exit(1); \
		} \
	} while (0)

#define CHECK_EQUAL(_is, _should_be) \
	do { \
		const long long _a = (long long)(_is), _b = (long long)(_should_be); \
		if (_a != _b) { \
			fprintf(stderr, "%s:%d: %s is %lld, and should be %lld (errno %s)\n", __FILE__, __LINE__, \
				#_is, _a, _b, strerror(errno)); \
			exit(1); \
		} \
	} while (0)

/* The call fails with this errno. */
#define CHECK_FAILS(_call, _failed, _errno) \
	do { \
		errno = 0; \
		CHECK((_call) == (_failed)); \
		CHECK_EQUAL(errno, _errno); \
	} while (0)

/* As long as anybody waits for what must come, before it is called missing. */
#define PATIENCE_MS 30000
#define PATIENCE_US (PATIENCE_MS * 1000)

#endif
