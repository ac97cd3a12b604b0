/**
 * @file px4_platform_common/getopt.h
 *
 * Stands for PX4's getopt, which keeps its state with its caller.
 */

#ifndef UORB_PX4_GETOPT_H
#define UORB_PX4_GETOPT_H

#include <visibility.h>

__BEGIN_DECLS

/**
 * The next option: its letter; '?' if it is unknown or lacks its argument; -1
 * when there are no more. *myoptind starts at 1 and ends at the first argument
 * that is no option; these are moved behind the options. *myoptarg is the
 * option's argument.
 */
__EXPORT extern int px4_getopt(int argc, char *argv[], const char *options, int *myoptind, const char **myoptarg);

__END_DECLS

#endif /* UORB_PX4_GETOPT_H */
