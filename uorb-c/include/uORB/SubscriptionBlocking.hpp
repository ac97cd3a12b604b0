/**
 * @file SubscriptionBlocking.hpp
 *
 * A subscription that waits for its update: PX4's class.
 *
 * The wait asks for the bell first and looks at the node after that, so no
 * publish falls in between. PX4's looks first, and sleeps through a message
 * that comes at that moment.
 */

#ifndef UORB_SUBSCRIPTIONBLOCKING_HPP
#define UORB_SUBSCRIPTIONBLOCKING_HPP

#include <errno.h>

#include <uORB/SubscriptionCallback.hpp>

namespace uORB
{

/** Waits for updates. No callback is needed for that: `call` is never called,
 * unless a class that overrides it registers it. */
template<typename T>
class SubscriptionBlocking : public SubscriptionCallback
{
public:
	SubscriptionBlocking(ORB_ID id, uint32_t interval_us = 0, uint8_t instance = 0) :
		SubscriptionCallback(id, interval_us, instance) {}

	SubscriptionBlocking(const orb_metadata *meta, uint32_t interval_us = 0, uint8_t instance = 0) :
		SubscriptionCallback(meta, interval_us, instance) {}

	void call() override {}

	/**
	 * Waits until there is a message that was not copied yet, and the interval is
	 * over; a timeout of 0 is none. False, with errno 0: the time is over. False,
	 * with another errno: there is nothing to wait for, ESHUTDOWN if the system
	 * has ended.
	 */
	bool updatedBlocking(uint32_t timeout_us = 0)
	{
		const uint64_t start = now_us();

		while (make_node()) {
			const uint64_t elapsed = now_us() - start;
			const bool is_over = timeout_us != 0 && elapsed >= timeout_us;
			const uint64_t left = timeout_us == 0 ? UINT64_MAX : is_over ? 0 : timeout_us - elapsed;
			const uint64_t interval_left = interval_left_us();
			const bool is_pending = _subscription.updated();

			if (is_pending && interval_left == 0) {
				return true;
			}

			if (is_over) {
				errno = 0;
				return false;
			}

			if (is_pending) {
				// A message is there; only time can make it an update.
				sleep_us(left < interval_left ? left : interval_left);

			} else if (uorb_wait(_subscription._follower, timeout_us == 0 ? -1 : static_cast<int64_t>(left)) < 0) {
				return false;
			}
		}

		return false;
	}

	/** Waits for the next message and copies it. */
	bool updateBlocking(T &data, uint32_t timeout_us = 0)
	{
		return updatedBlocking(timeout_us) && copy(&data);
	}

private:
	/** Who waits has to have something to wait at. */
	bool make_node()
	{
		if (!valid()) {
			_subscription._follower = uorb_follow(get_topic(), get_instance(), true);
		}

		return valid();
	}

	/** Sleeps so long, or until a signal comes. */
	static void sleep_us(uint64_t time_us)
	{
		timespec time;
		time.tv_sec = static_cast<time_t>(time_us / 1000000);
		time.tv_nsec = static_cast<long>(time_us % 1000000 * 1000);
		nanosleep(&time, nullptr);
	}
};

} // namespace uORB

#endif // UORB_SUBSCRIPTIONBLOCKING_HPP
