/**
 * @file Subscription.hpp
 *
 * A subscription as an object: PX4's classes of this name.
 *
 *     uORB::Subscription attitude{ORB_ID(vehicle_attitude)};
 *     vehicle_attitude_s message;
 *
 *     if (attitude.update(&message)) { ... }
 *
 * It has no descriptor and cannot be polled, so it costs a publisher nothing.
 * It follows a node that exists; while there is none, every call looks again.
 * What was published stays readable when its publisher is gone: `advertised`
 * says whether there is one, and nothing else depends on it.
 */

#ifndef UORB_SUBSCRIPTION_HPP
#define UORB_SUBSCRIPTION_HPP

#include <uORB/uORB.h>
#include <uORB/uORBFollower.h>
#include <uORB/topics/uORBTopics.hpp>

// What modules of PX4 get from this header. Others may have an OK of their own.
#if defined(PX4_MAIN) || defined(MODULE_NAME)
# include <px4_platform_common/defines.h>
#endif

namespace uORB
{

/** Follows one instance of a topic. For one thread at a time. */
class Subscription
{
public:
	Subscription(ORB_ID id, uint8_t instance = 0) : Subscription(get_orb_meta(id), instance) {}

	Subscription(const orb_metadata *meta = nullptr, uint8_t instance = 0) : _meta(meta), _instance(instance)
	{
		subscribe();
	}

	// A copy follows the same instance by itself, from its first call on. What the
	// other has copied is new to it.
	Subscription(const Subscription &other) : _meta(other._meta), _instance(other._instance) {}
	Subscription(Subscription &&other) noexcept : _meta(other._meta), _instance(other._instance) {}

	Subscription &operator=(const Subscription &other)
	{
		unsubscribe();
		_meta = other._meta;
		_instance = other._instance;
		return *this;
	}

	Subscription &operator=(Subscription &&other) noexcept { return *this = other; }

	~Subscription() { unsubscribe(); }

	/** Follows the instance, if it exists. Every other call does so, too. */
	bool subscribe()
	{
		if (_follower == nullptr && _meta != nullptr) {
			_follower = uorb_follow(_meta, _instance, false);
		}

		return valid();
	}

	/** Ends it, until the next call. The newest message is new again then. */
	void unsubscribe()
	{
		uorb_unfollow(_follower);
		_follower = nullptr;
	}

	bool valid() const { return _follower != nullptr; }

	/** Whether the instance has a publisher. */
	bool advertised() { return subscribe() && uorb_advertised(_follower); }

	/** Whether there is a message that was not copied yet. */
	bool updated() { return subscribe() && uorb_updates(_follower) > 0; }

	/** Copies the next message, if there is one that was not copied yet. */
	bool update(void *dst) { return updated() && uorb_copy(_follower, dst); }

	/** Copies the next message, or the last one again. */
	bool copy(void *dst) { return subscribe() && uorb_copy(_follower, dst); }

	/** Turns to another instance. False, and nothing changes, if it does not exist. */
	bool ChangeInstance(uint8_t instance)
	{
		if (instance == _instance) {
			return true;
		}

		uorb_follower *other = _meta == nullptr ? nullptr : uorb_follow(_meta, instance, false);

		if (other == nullptr) {
			return false;
		}

		uorb_unfollow(_follower);
		_follower = other;
		_instance = instance;
		return true;
	}

	uint8_t get_instance() const { return _instance; }

	/** The generation of the message that was copied last: of two, the difference
	 * less one is what was lost in between. */
	unsigned get_last_generation() const { return valid() ? uorb_generation(_follower) : 0; }

	orb_id_t get_topic() const { return _meta; }

	/** INVALID for a topic that is defined in code. */
	ORB_ID orb_id() const
	{
		const bool has_id = _meta != nullptr && _meta->o_id != ORB_ID_NONE;
		return has_id ? static_cast<ORB_ID>(_meta->o_id) : ORB_ID::INVALID;
	}

protected:
	template<typename T> friend class SubscriptionBlocking;

	uorb_follower *_follower{nullptr};
	orb_id_t _meta;
	uint8_t _instance;
};

/** A subscription that has its message within. What was published before is
 * there from the start, and is no update. */
template<class T>
class SubscriptionData : public Subscription
{
public:
	SubscriptionData(ORB_ID id, uint8_t instance = 0) : SubscriptionData(get_orb_meta(id), instance) {}

	SubscriptionData(const orb_metadata *meta, uint8_t instance = 0) : Subscription(meta, instance)
	{
		copy(&_data);
	}

	SubscriptionData(const SubscriptionData &) = delete;
	SubscriptionData &operator=(const SubscriptionData &) = delete;

	/** Takes the next message, if there is one that was not copied yet. */
	bool update() { return Subscription::update(&_data); }

	const T &get() const { return _data; }

private:
	T _data{};
};

} // namespace uORB

#endif // UORB_SUBSCRIPTION_HPP
