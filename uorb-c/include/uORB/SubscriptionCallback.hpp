/**
 * @file SubscriptionCallback.hpp
 *
 * A subscription that calls back: PX4's class.
 *
 * PX4 calls on the thread that publishes, within its publish. Here the
 * publisher is another process: `call` runs in a thread of the library, once
 * for several messages that came while it ran. If it uses the subscription, no
 * other thread may meanwhile.
 */

#ifndef UORB_SUBSCRIPTIONCALLBACK_HPP
#define UORB_SUBSCRIPTIONCALLBACK_HPP

#include <uORB/SubscriptionInterval.hpp>

namespace uORB
{

/**
 * Has `call` called after each publish, whatever the interval.
 *
 * A class that is made of this ends its calls before its members go: it calls
 * `unregisterCallback` in its own destructor, unless nobody publishes any more.
 */
class SubscriptionCallback : public SubscriptionInterval
{
public:
	SubscriptionCallback(ORB_ID id, uint32_t interval_us = 0, uint8_t instance = 0) :
		SubscriptionInterval(id, interval_us, instance) {}

	SubscriptionCallback(const orb_metadata *meta, uint32_t interval_us = 0, uint8_t instance = 0) :
		SubscriptionInterval(meta, interval_us, instance) {}

	SubscriptionCallback(const SubscriptionCallback &) = delete;
	SubscriptionCallback &operator=(const SubscriptionCallback &) = delete;

	virtual ~SubscriptionCallback() { unregisterCallback(); }

	/** Begins the calls. The node is made if it is not there. */
	bool registerCallback()
	{
		if (!registered()) {
			_registration = uorb_register_callback(get_topic(), get_instance(), forward, this);
			subscribe();
		}

		return registered();
	}

	/** No call runs any more when it has returned, unless it was called in `call`. */
	void unregisterCallback()
	{
		if (registered()) {
			uorb_unregister_callback(_registration);
			_registration = NONE;
		}
	}

	/** Turns to another instance, and takes the calls along. */
	bool ChangeInstance(uint8_t instance)
	{
		if (instance == get_instance()) {
			return true;
		}

		const bool was_registered = registered();
		unregisterCallback();
		const bool changed = _subscription.ChangeInstance(instance);

		if (was_registered) {
			registerCallback();
		}

		return changed;
	}

	virtual void call() = 0;

	bool registered() const { return _registration != NONE; }

private:
	static constexpr int NONE = -1;

	static void forward(void *self) { static_cast<SubscriptionCallback *>(self)->call(); }

	int _registration{NONE};
};

} // namespace uORB

#endif // UORB_SUBSCRIPTIONCALLBACK_HPP
