/**
 * @file px4_platform_common/posix.h
 *
 * Stands for PX4's files and its poll. A subscription is a file descriptor
 * here, as on NuttX, so all of this is POSIX's.
 */

#ifndef UORB_PX4_POSIX_H
#define UORB_PX4_POSIX_H

#include <fcntl.h>
#include <poll.h>
#include <stdint.h>
#include <sys/types.h>
#include <unistd.h>

#include <px4_platform_common/defines.h>
/* PX4's brings the log along, and programs count on it. */
#include <px4_platform_common/log.h>
#include <px4_platform_common/tasks.h>

#define PX4_F_RDONLY O_RDONLY
#define PX4_F_WRONLY O_WRONLY
#define PX4_F_CREAT O_CREAT

#define px4_open open
#define px4_close close
#define px4_read read
#define px4_write write
#define px4_ioctl ioctl
#define px4_fsync fsync
#define px4_access access

/** What a stack of NuttX has to be here: addresses are twice as long, and the C
 * library wants its share. px4_task_spawn_cmd sees to that by itself. */
#define PX4_STACK_OVERHEAD (1024 * 24)
#define PX4_STACK_ADJUSTED(_size) ((_size) * (__SIZEOF_POINTER__ >> 2) + PX4_STACK_OVERHEAD)

typedef struct pollfd px4_pollfd_struct_t;
typedef short px4_pollevent_t;
typedef short pollevent_t;

__BEGIN_DECLS

/**
 * Waits until a subscription has an update or another descriptor is ready, for
 * so many milliseconds; negative: for ever. Returns how many are, 0 when the
 * time is over or a signal came, -1 with errno set. In libuorb.
 */
__EXPORT extern int px4_poll(px4_pollfd_struct_t *fds, unsigned nfds, int timeout);

/** What programs call: a task that was deleted meanwhile ends behind it. */
static inline int px4_task_poll(px4_pollfd_struct_t *fds, unsigned nfds, int timeout)
{
	const int ready = px4_poll(fds, nfds, timeout);
	px4_task_may_end();
	return ready;
}

#define px4_poll px4_task_poll

__END_DECLS

#endif /* UORB_PX4_POSIX_H */
