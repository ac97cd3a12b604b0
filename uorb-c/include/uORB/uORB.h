/**
 * @file uORB.h
 *
 * uORB between processes, for programs in C and C++ that were written for PX4:
 * the functions and macros of PX4's header of this name (2016 to today), on a
 * bus that is shared by processes.
 *
 * What holds of all functions:
 *
 * - One that returns an int returns 0 (OK) or -1 (ERROR) with errno set, unless
 *   it says otherwise. Why it failed is also said on stderr, once a call, by
 *   all but orb_publish, orb_copy, orb_check and px4_poll.
 * - A subscription is a file descriptor: it works in poll(2), epoll and
 *   select(2), which takes numbers below 1,024. Give it back with
 *   orb_unsubscribe, not with close. A publication is a small number.
 *   A handle that is none, or none any more, is EBADF.
 * - All may be called from any thread. Let one thread use one subscription:
 *   a copy in another takes its update away. Publications may be shared freely.
 *   A thread that is inside of one must not be cancelled (pthread_cancel).
 * - orb_publish may be called from a signal handler, also of a topic that the
 *   signal interrupts while it is published; no other function may.
 * - In the child of a fork the parent's handles fail with EPERM; copy and check
 *   go on working. New handles are the child's own.
 * - The bus is the one that UORB_DIR and UORB_SYSTEM name. ECONNREFUSED: no
 *   broker runs there (`uorb start`). ESHUTDOWN: it was stopped (`uorb stop`).
 *   ETIMEDOUT: it does not answer.
 *
 * docs/differences-from-px4.md lists what differs from PX4, whose eras differ
 * from each other.
 */

#ifndef UORB_UORB_H
#define UORB_UORB_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#ifndef __EXPORT
# define __EXPORT __attribute__((visibility("default")))
#endif

/** The place of a topic in the sorted list of all topics of one build. */
typedef uint16_t orb_id_size_t;

/** The o_id of a topic that is in no such list. */
#define ORB_ID_NONE ((orb_id_size_t)UINT16_MAX)

struct orb_layout;

/** What a topic is: name, size and fields of its messages. */
struct orb_metadata {
	const char *o_name;               /**< unique name */
	const uint16_t o_size;            /**< bytes of a message, 65,535 at most */
	const uint16_t o_size_no_padding; /**< bytes without the padding at the end (for a logger) */
	const char *o_fields;             /**< "float[3] xyz;bool armed;", in the order of memory; NULL: untyped */
	uint32_t message_hash;            /**< PX4's hash of the .msg text; 0: unknown */
	orb_id_size_t o_id;               /**< ORB_ID enum */
	uint8_t o_queue;                  /**< messages that a node keeps; 0: an optional topic */
	const struct orb_layout *o_layout; /**< not in PX4: all that the .msg says; NULL: o_fields does */
};

/** The fields of a message in the order of its .msg. The message compiler writes it. */
struct orb_layout {
	const char *name;                 /**< of the message: "esc_status" */
	uint32_t message_hash;
	uint16_t size;                    /**< bytes, with padding */
	uint16_t field_count;
	const struct orb_field *fields;
};

/** One field of a message. */
struct orb_field {
	const char *name;
	const char *type;                 /**< "float", "uint64_t", or "esc_report", which is nested */
	uint16_t array_length;            /**< elements; 0: not an array */
	uint16_t offset;                  /**< bytes from the start of its message */
	const char *unit;                 /**< "m/s^2"; "": none given */
	const struct orb_layout *nested;  /**< what a nested message is made of, else NULL */
};

typedef const struct orb_metadata *orb_id_t;

/** Instances of a topic: 0 to 9. */
#define ORB_MULTI_MAX_INSTANCES 10

/** How much one instance is to be preferred over others. uORB does not use it. */
enum ORB_PRIO {
	ORB_PRIO_MIN = 1, /* 0 is free, for a variable that is not set yet */
	ORB_PRIO_VERY_LOW = 25,
	ORB_PRIO_LOW = 50,
	ORB_PRIO_DEFAULT = 75,
	ORB_PRIO_HIGH = 100,
	ORB_PRIO_VERY_HIGH = 125,
	ORB_PRIO_MAX = 255
};

/** The metadata of a topic that was declared before, with ORB_DECLARE. */
#define ORB_ID(_name) &__orb_##_name

/** Declares a topic. Headers do it; one source file defines it. */
#ifdef __cplusplus
# define ORB_DECLARE(_name) extern "C" const struct orb_metadata __orb_##_name __EXPORT
#else
# define ORB_DECLARE(_name) extern const struct orb_metadata __orb_##_name __EXPORT
#endif

/** Declares a topic that the program may have or not. Where it has not,
 * ORB_ID of it is NULL, with which all functions fail with ENOENT. */
#define ORB_DECLARE_OPTIONAL(_name) ORB_DECLARE(_name) __attribute__((weak))

/**
 * Defines a topic, in one source file of the program, in any of these forms:
 *
 *     ORB_DEFINE(name)                     messages are struct name_data
 *     ORB_DEFINE(name, struct)             exactly the struct's bytes, untyped
 *     ORB_DEFINE(name, struct, size_no_padding, fields)
 *     ORB_DEFINE(name, struct, size_no_padding, fields, id)        to PX4 1.15
 *     ORB_DEFINE(name, struct, size_no_padding, hash, id, queue)   PX4 1.16 on
 */
#define ORB_DEFINE(...) \
	UORB_PICK_7TH(__VA_ARGS__, UORB_DEFINE_6, UORB_DEFINE_5, UORB_DEFINE_4, UORB_DEFINE_3, \
		      UORB_DEFINE_2, UORB_DEFINE_1, 0)(__VA_ARGS__)

/**
 * Defines a topic that the program only subscribes, and only where another
 * process has described it: until then orb_subscribe fails with ENOENT.
 * With the name alone it is ORB_DECLARE_OPTIONAL.
 */
#define ORB_DEFINE_OPTIONAL(...) \
	UORB_PICK_3RD(__VA_ARGS__, UORB_DEFINE_OPTIONAL_2, ORB_DECLARE_OPTIONAL, 0)(__VA_ARGS__)

#define UORB_PICK_3RD(_1, _2, _3, ...) _3
#define UORB_PICK_7TH(_1, _2, _3, _4, _5, _6, _7, ...) _7

#define UORB_DEFINE_1(_name) UORB_DEFINE_2(_name, struct _name##_data)
#define UORB_DEFINE_2(_name, _struct) \
	UORB_DEFINE(_name, _struct, sizeof(_struct), NULL, 0, ORB_ID_NONE, 1, NULL)
/* Three arguments are in no era of PX4; the compiler says so. */
#define UORB_DEFINE_3(_name, _struct, _size_no_padding) \
	UORB_STATIC_ASSERT(0, "ORB_DEFINE takes 1, 2, 4, 5 or 6 arguments")
#define UORB_DEFINE_4(_name, _struct, _size_no_padding, _fields) \
	UORB_DEFINE(_name, _struct, _size_no_padding, _fields, 0, ORB_ID_NONE, 1, NULL)
#define UORB_DEFINE_5(_name, _struct, _size_no_padding, _fields, _id) \
	UORB_DEFINE(_name, _struct, _size_no_padding, _fields, 0, _id, 1, NULL)
#define UORB_DEFINE_6(_name, _struct, _size_no_padding, _hash, _id, _queue) \
	UORB_DEFINE(_name, _struct, _size_no_padding, NULL, _hash, _id, _queue, NULL)
#define UORB_DEFINE_OPTIONAL_2(_name, _struct) \
	UORB_DEFINE(_name, _struct, sizeof(_struct), NULL, 0, ORB_ID_NONE, 0, NULL)

#ifdef __cplusplus
# define UORB_STATIC_ASSERT(_holds, _why) static_assert(_holds, _why)
#else
# define UORB_STATIC_ASSERT(_holds, _why) _Static_assert(_holds, _why)
#endif

/* Ends without a semicolon, which the user writes. Declared first, because a
 * constant of C++ is seen in its own file only unless it was. */
#define UORB_DEFINE(_name, _struct, _size_no_padding, _fields, _hash, _id, _queue, _layout) \
	UORB_STATIC_ASSERT(sizeof(_struct) <= UINT16_MAX, \
			   "topic " #_name ": a message has 65,535 bytes at most in C; " \
			   "larger ones travel on streams, which programs in Rust read and write"); \
	ORB_DECLARE(_name); \
	const struct orb_metadata __orb_##_name = { \
		#_name, sizeof(_struct), _size_no_padding, _fields, _hash, _id, _queue, _layout \
	}

/**
 * A publication, in C an integer: -1 for none. In C++ it is a pointer, nullptr
 * for none. Underneath it is the same small number, 1 and up.
 */
#ifdef __cplusplus
typedef void *orb_advert_t;
#else
typedef int orb_advert_t;
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* In C++ the functions that take or return an orb_advert_t are defined below,
 * over these, which have the names of C. */
#ifdef __cplusplus
# define UORB_IN_CPP(_name) uorb_c_##_name
# define UORB_NAMED(_name) __asm__(#_name)
#else
# define UORB_IN_CPP(_name) _name
# define UORB_NAMED(_name)
#endif

/**
 * Becomes a publisher of instance 0, beside any others, and publishes data, if
 * it is not NULL. Returns the publication, or -1 (in C++ nullptr).
 * ENOENT: meta is NULL. EINVAL: a live process uses the topic with another
 * layout. EIO: refused. ENOSPC: /dev/shm is full. EMFILE: ulimit -n.
 */
__EXPORT extern int UORB_IN_CPP(orb_advertise)(const struct orb_metadata *meta, const void *data)
	UORB_NAMED(orb_advertise);

/** As orb_advertise, with a longer queue than the .msg asks for: rounded up to
 * a power of two, 128 at most. Only the first publisher of a node has a say. */
__EXPORT extern int UORB_IN_CPP(orb_advertise_queue)(const struct orb_metadata *meta, const void *data,
		unsigned queue_size) UORB_NAMED(orb_advertise_queue);

/**
 * Claims the lowest instance that nobody has advertised and stores it in
 * *instance; with instance NULL it is orb_advertise. In C, too, the priority
 * may be left out. EIO: all ten instances are advertised.
 */
__EXPORT extern int UORB_IN_CPP(orb_advertise_multi)(const struct orb_metadata *meta, const void *data,
		int *instance, int priority) UORB_NAMED(orb_advertise_multi);

/** Both at once. In C, too, the priority, before the queue size, may be left out. */
__EXPORT extern int UORB_IN_CPP(orb_advertise_multi_queue)(const struct orb_metadata *meta, const void *data,
		int *instance, int priority, unsigned queue_size) UORB_NAMED(orb_advertise_multi_queue);

/** Stops being a publisher. The topic's last message stays. EBADF; EINVAL: the
 * handle is -1 or NULL. */
__EXPORT extern int UORB_IN_CPP(orb_unadvertise)(int handle) UORB_NAMED(orb_unadvertise);

/**
 * Makes data, o_size bytes, the newest message. Never waits, never allocates,
 * and makes no system call unless somebody sleeps.
 * EFAULT: a NULL among the arguments, or no publication. EBADF. EINVAL: meta is
 * another topic's. EAGAIN: more threads than 16 publish on the node at once.
 */
__EXPORT extern int UORB_IN_CPP(orb_publish)(const struct orb_metadata *meta, int handle, const void *data)
	UORB_NAMED(orb_publish);

/** Publishes on *handle, or, where it is none yet, claims an instance for it
 * first. In C, too, the priority may be left out. */
__EXPORT extern int UORB_IN_CPP(orb_publish_auto)(const struct orb_metadata *meta, int *handle, const void *data,
		int *instance, int priority) UORB_NAMED(orb_publish_auto);

/** The instance of a publication; -1 and EBADF if it is none. */
__EXPORT extern int UORB_IN_CPP(orb_get_instance)(int handle) UORB_NAMED(orb_get_instance);

/**
 * Follows instance 0, whether it was advertised yet or not. If anything was
 * ever published on it, the newest message is pending. Returns the descriptor.
 * ENOENT: meta is NULL, or an optional topic that nobody has described.
 * Otherwise as orb_advertise.
 */
__EXPORT extern int orb_subscribe(const struct orb_metadata *meta);

/** Follows one of the instances. EIO: there is no such instance. */
__EXPORT extern int orb_subscribe_multi(const struct orb_metadata *meta, unsigned instance);

/** Ends a subscription and closes its descriptor. */
__EXPORT extern int orb_unsubscribe(int handle);

/**
 * Copies the next message, o_size bytes: the oldest that was not copied and is
 * still there, or the last one again. With buffer NULL it copies nothing, and
 * nothing is new any more. EIO: nothing was ever published, or meta is another
 * topic's.
 */
__EXPORT extern int orb_copy(const struct orb_metadata *meta, int handle, void *buffer);

/** Stores whether there is something that was not copied yet, and the
 * interval, if there is one, is over. */
__EXPORT extern int orb_check(int handle, bool *updated);

/** Stores when the newest message was published, in microseconds of
 * hrt_absolute_time; 0 if nothing ever was. */
__EXPORT extern int orb_stat(int handle, uint64_t *time);

/** 0 if the instance has a publisher, else -1. */
__EXPORT extern int orb_exists(const struct orb_metadata *meta, int instance);

/** The number of instances from 0 up to the first that does not exist. One that
 * is only subscribed exists. */
__EXPORT extern int orb_group_count(const struct orb_metadata *meta);

/** Stores the priority of the instance: that of its newest publisher. */
__EXPORT extern int orb_priority(int handle, int32_t *priority);

/** Shows at most one update in so many milliseconds; 0: all of them. What was
 * published meanwhile is pending when the interval ends, and poll wakes. */
__EXPORT extern int orb_set_interval(int handle, unsigned interval);

/** Stores the interval in milliseconds. */
__EXPORT extern int orb_get_interval(int handle, unsigned *interval);

/** The queue length that the topic's .msg asks for; 0 if meta is NULL. */
static inline uint8_t orb_get_queue_size(const struct orb_metadata *meta)
{
	return meta == NULL ? 0 : meta->o_queue;
}

#ifdef __cplusplus
} /* extern "C" */

/* Also where this header is included within extern "C". */
extern "C++" {

inline orb_advert_t uorb_to_advert(int handle)
{
	return handle < 0 ? nullptr : reinterpret_cast<orb_advert_t>(static_cast<intptr_t>(handle));
}

inline int uorb_from_advert(orb_advert_t handle)
{
	return handle == nullptr ? -1 : static_cast<int>(reinterpret_cast<intptr_t>(handle));
}

inline orb_advert_t orb_advertise(const struct orb_metadata *meta, const void *data)
{
	return uorb_to_advert(uorb_c_orb_advertise(meta, data));
}

inline orb_advert_t orb_advertise_queue(const struct orb_metadata *meta, const void *data, unsigned queue_size)
{
	return uorb_to_advert(uorb_c_orb_advertise_queue(meta, data, queue_size));
}

inline orb_advert_t orb_advertise_multi(const struct orb_metadata *meta, const void *data, int *instance,
					int priority = ORB_PRIO_DEFAULT)
{
	return uorb_to_advert(uorb_c_orb_advertise_multi(meta, data, instance, priority));
}

inline orb_advert_t orb_advertise_multi_queue(const struct orb_metadata *meta, const void *data, int *instance,
		int priority, unsigned queue_size)
{
	return uorb_to_advert(uorb_c_orb_advertise_multi_queue(meta, data, instance, priority, queue_size));
}

inline orb_advert_t orb_advertise_multi_queue(const struct orb_metadata *meta, const void *data, int *instance,
		unsigned queue_size)
{
	return orb_advertise_multi_queue(meta, data, instance, ORB_PRIO_DEFAULT, queue_size);
}

inline int orb_unadvertise(orb_advert_t handle)
{
	return uorb_c_orb_unadvertise(uorb_from_advert(handle));
}

inline int orb_publish(const struct orb_metadata *meta, orb_advert_t handle, const void *data)
{
	return uorb_c_orb_publish(meta, uorb_from_advert(handle), data);
}

inline int orb_publish_auto(const struct orb_metadata *meta, orb_advert_t *handle, const void *data, int *instance,
			    int priority = ORB_PRIO_DEFAULT)
{
	int number = handle == nullptr ? -1 : uorb_from_advert(*handle);
	const int published = uorb_c_orb_publish_auto(meta, handle == nullptr ? nullptr : &number, data, instance,
			      priority);

	if (handle != nullptr) {
		*handle = uorb_to_advert(number);
	}

	return published;
}

inline int orb_get_instance(orb_advert_t handle)
{
	return uorb_c_orb_get_instance(uorb_from_advert(handle));
}

} // extern "C++"

#else /* C: what C++ does by default arguments and overloads */

#define orb_advertise_multi(_meta, _data, ...) \
	UORB_MULTI(_meta, _data, __VA_ARGS__, ORB_PRIO_DEFAULT, 0)
#define UORB_MULTI(_meta, _data, _instance, _priority, ...) \
	(orb_advertise_multi)(_meta, _data, _instance, _priority)

#define orb_publish_auto(_meta, _handle, _data, ...) \
	UORB_AUTO(_meta, _handle, _data, __VA_ARGS__, ORB_PRIO_DEFAULT, 0)
#define UORB_AUTO(_meta, _handle, _data, _instance, _priority, ...) \
	(orb_publish_auto)(_meta, _handle, _data, _instance, _priority)

#define orb_advertise_multi_queue(_meta, _data, _instance, ...) \
	UORB_PICK_3RD(__VA_ARGS__, UORB_MULTI_QUEUE_5, UORB_MULTI_QUEUE_4, 0)(_meta, _data, _instance, __VA_ARGS__)
#define UORB_MULTI_QUEUE_4(_meta, _data, _instance, _queue_size) \
	(orb_advertise_multi_queue)(_meta, _data, _instance, ORB_PRIO_DEFAULT, _queue_size)
#define UORB_MULTI_QUEUE_5(_meta, _data, _instance, _priority, _queue_size) \
	(orb_advertise_multi_queue)(_meta, _data, _instance, _priority, _queue_size)

#endif

#endif /* UORB_UORB_H */
