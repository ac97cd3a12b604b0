/**
 * @file uORBFollower.h
 *
 * What the C++ classes stand on: a subscription without a descriptor, which
 * costs a publisher nothing, and callbacks. Not in PX4; programs use the classes.
 *
 * One thread uses a follower at a time. The instance's node is followed, not
 * made: a follower of a node that does not exist is none (NULL, ENOENT).
 */

#ifndef UORB_UORBFOLLOWER_H
#define UORB_UORBFOLLOWER_H

#include <uORB/uORB.h>

#ifdef __cplusplus
extern "C" {
#endif

struct uorb_follower;

/** Follows a node that exists, or, if it is to be made, any. If anything was
 * ever published on it, the newest message is pending. NULL with errno set as
 * orb_subscribe does; ENOENT says nothing on stderr. */
__EXPORT extern struct uorb_follower *uorb_follow(const struct orb_metadata *meta, unsigned instance, bool make);

/** Ends it. NULL is nothing to end. */
__EXPORT extern void uorb_unfollow(struct uorb_follower *follower);

/** How many messages were published that it has not copied, those included that
 * are overwritten by now. */
__EXPORT extern unsigned uorb_updates(struct uorb_follower *follower);

/** Copies the next message, or the last one again; false if nothing was ever
 * published. */
__EXPORT extern bool uorb_copy(struct uorb_follower *follower, void *message);

/** Whether the instance has a publisher. */
__EXPORT extern bool uorb_advertised(struct uorb_follower *follower);

/** The generation that it copied last: how many messages were published up to
 * it, modulo 2^32. */
__EXPORT extern unsigned uorb_generation(const struct uorb_follower *follower);

/** Waits until there is something to copy: 1. 0: the time is over, or a signal
 * came; a negative timeout is none. -1 with errno: ESHUTDOWN, EPERM, EMFILE. */
__EXPORT extern int uorb_wait(struct uorb_follower *follower, int64_t timeout_us);

/**
 * Has call(argument) called, in a thread of the library, after each publish on
 * the instance; once for several that came while it ran. The node is made if it
 * is not there. Returns a number, 1 and up, or -1 with errno set.
 */
__EXPORT extern int uorb_register_callback(const struct orb_metadata *meta, unsigned instance,
		void (*call)(void *argument), void *argument);

/** No call begins after it has returned, and none runs any more, unless it was
 * called in the very callback. */
__EXPORT extern void uorb_unregister_callback(int registration);

#ifdef __cplusplus
} /* extern "C" */
#endif

#endif /* UORB_UORBFOLLOWER_H */
