/**
 * @file SubscriptionMultiArray.hpp
 *
 * A subscription for each instance of a topic: PX4's class.
 *
 *     uORB::SubscriptionMultiArray<sensor_accel_s> accels{ORB_ID::sensor_accel};
 *
 *     for (auto &accel : accels) { ... }
 */

#ifndef UORB_SUBSCRIPTIONMULTIARRAY_HPP
#define UORB_SUBSCRIPTIONMULTIARRAY_HPP

#include <uORB/Subscription.hpp>

namespace uORB
{

/** Follows the instances 0 to SIZE - 1, those too that are not there yet. */
template<typename T, uint8_t SIZE = ORB_MULTI_MAX_INSTANCES>
class SubscriptionMultiArray
{
public:
	static_assert(SIZE <= ORB_MULTI_MAX_INSTANCES, "a topic has ten instances at most");

	static constexpr uint8_t size() { return SIZE; }

	explicit SubscriptionMultiArray(ORB_ID id) : SubscriptionMultiArray(get_orb_meta(id)) {}

	explicit SubscriptionMultiArray(const orb_metadata *meta)
	{
		for (uint8_t instance = 0; instance < SIZE; instance++) {
			_subscriptions[instance] = Subscription{meta, instance};
			_subscriptions[instance].subscribe();
		}
	}

	Subscription &operator[](int instance) { return _subscriptions[instance]; }
	const Subscription &operator[](int instance) const { return _subscriptions[instance]; }

	Subscription *begin() { return _subscriptions; }
	Subscription *end() { return _subscriptions + SIZE; }
	const Subscription *begin() const { return _subscriptions; }
	const Subscription *end() const { return _subscriptions + SIZE; }

	/** Whether any instance has a publisher. */
	bool advertised() { return advertised_count() > 0; }

	/** How many instances have a publisher. */
	uint8_t advertised_count()
	{
		uint8_t count = 0;

		for (auto &subscription : _subscriptions) {
			count += subscription.advertised() ? 1 : 0;
		}

		return count;
	}

	/** Whether any instance has a message that was not copied yet. */
	bool updated()
	{
		for (auto &subscription : _subscriptions) {
			if (subscription.updated()) {
				return true;
			}
		}

		return false;
	}

private:
	Subscription _subscriptions[SIZE];
};

} // namespace uORB

#endif // UORB_SUBSCRIPTIONMULTIARRAY_HPP
