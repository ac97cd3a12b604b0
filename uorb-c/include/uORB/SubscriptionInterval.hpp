/**
 * @file SubscriptionInterval.hpp
 *
 * A subscription that sees at most one update in an interval: PX4's class.
 *
 * Updates are counted from a time that moves on by one interval with every
 * copy, so that a copy that comes late does not make the next one late, too.
 * The first update is seen at once and begins the count.
 */

#ifndef UORB_SUBSCRIPTIONINTERVAL_HPP
#define UORB_SUBSCRIPTIONINTERVAL_HPP

#include <time.h>

#include <uORB/Subscription.hpp>

// What modules of PX4 get from this header. Others may have an OK of their own.
#if defined(PX4_MAIN) || defined(MODULE_NAME)
# include <drivers/drv_hrt.h>
#endif

namespace uORB
{

/** Follows one instance of a topic, slowly. For one thread at a time. */
class SubscriptionInterval
{
public:
	SubscriptionInterval(ORB_ID id, uint32_t interval_us = 0, uint8_t instance = 0) :
		SubscriptionInterval(get_orb_meta(id), interval_us, instance) {}

	SubscriptionInterval(const orb_metadata *meta, uint32_t interval_us = 0, uint8_t instance = 0) :
		_subscription(meta, instance), _interval_us(interval_us) {}

	SubscriptionInterval() : _subscription(nullptr) {}

	bool subscribe() { return _subscription.subscribe(); }
	void unsubscribe() { _subscription.unsubscribe(); }

	bool valid() const { return _subscription.valid(); }
	bool advertised() { return _subscription.advertised(); }

	/** Whether there is a message that was not copied yet, and the interval is over. */
	bool updated() { return interval_left_us() == 0 && _subscription.updated(); }

	/** Copies the next message, if there is one and the interval is over. */
	bool update(void *dst) { return updated() && copy(dst); }

	/** Copies the next message, or the last one again, at any time. */
	bool copy(void *dst)
	{
		if (!_subscription.copy(dst)) {
			return false;
		}

		const uint64_t now = now_us();
		const uint64_t earliest = now > _interval_us ? now - _interval_us : 0;
		const uint64_t next = _last_update + _interval_us;

		// One interval on, but not into the future, and not so far behind that
		// several updates would follow each other. The first begins the count.
		if (_last_update == 0 || next > now) {
			_last_update = now;

		} else {
			_last_update = next > earliest ? next : earliest;
		}

		return true;
	}

	uint8_t get_instance() const { return _subscription.get_instance(); }
	uint32_t get_interval_us() const { return _interval_us; }
	unsigned get_last_generation() const { return _subscription.get_last_generation(); }
	orb_id_t get_topic() const { return _subscription.get_topic(); }

	void set_interval_us(uint32_t interval) { _interval_us = interval; }
	void set_interval_ms(uint32_t interval) { _interval_us = interval * 1000; }

	/** Sets when the interval that runs began, by hrt_absolute_time. */
	void set_last_update(uint64_t time_us) { _last_update = time_us; }

protected:
	/** How long no update is to be seen yet. */
	uint64_t interval_left_us() const
	{
		if (_last_update == 0) {
			return 0;
		}

		const uint64_t elapsed = now_us() - _last_update;
		return elapsed >= _interval_us ? 0 : _interval_us - elapsed;
	}

	/** The clock of hrt_absolute_time. */
	static uint64_t now_us()
	{
		timespec now;
		clock_gettime(CLOCK_MONOTONIC, &now);
		return static_cast<uint64_t>(now.tv_sec) * 1000000 + static_cast<uint64_t>(now.tv_nsec) / 1000;
	}

	Subscription _subscription;
	/** When the interval that runs began; 0: none does yet. */
	uint64_t _last_update{0};
	uint32_t _interval_us{0};
};

} // namespace uORB

#endif // UORB_SUBSCRIPTIONINTERVAL_HPP
