/**
 * @file Publication.hpp
 *
 * A publication as an object: PX4's classes of this name, over uORB.h.
 *
 *     uORB::Publication<vehicle_attitude_s> attitude{ORB_ID(vehicle_attitude)};
 *     attitude.publish(message);
 *
 * The first publish advertises. Unlike PX4's they keep the metadata and no
 * number, because a topic that is defined in code has none.
 */

#ifndef UORB_PUBLICATION_HPP
#define UORB_PUBLICATION_HPP

#include <uORB/uORB.h>
#include <uORB/topics/uORBTopics.hpp>

// What modules of PX4 get from this header. Others may have an OK of their own.
#if defined(PX4_MAIN) || defined(MODULE_NAME)
# include <px4_platform_common/defines.h>
# include <systemlib/err.h>
#endif

namespace uORB
{

/** The queue length that a generated message asks for, 1 where it says nothing. */
template<typename U>
class DefaultQueueSize
{
private:
	template<typename T>
	static constexpr uint8_t asked(decltype(T::ORB_QUEUE_LENGTH) *) { return T::ORB_QUEUE_LENGTH; }

	template<typename T>
	static constexpr uint8_t asked(...) { return 1; }

public:
	static constexpr unsigned value = asked<U>(nullptr);
};

/** What publications of all kinds have. */
class PublicationBase
{
public:
	bool advertised() const { return _handle != nullptr; }

	/** Stops being a publisher. The last message stays; the next publish advertises again. */
	bool unadvertise()
	{
		const int unadvertised = orb_unadvertise(_handle);
		_handle = nullptr;
		return unadvertised == 0;
	}

	orb_id_t get_topic() const { return _meta; }

protected:
	PublicationBase(orb_id_t meta, unsigned queue_size) : _meta(meta), _queue_size(queue_size) {}

	// A copy is another publication of the topic. The handle has one owner.
	PublicationBase(const PublicationBase &other) : _meta(other._meta), _queue_size(other._queue_size) {}
	PublicationBase &operator=(const PublicationBase &) = delete;

	~PublicationBase()
	{
		// A queue tells of requests, vehicle_command for one, that a short-lived
		// publisher leaves behind for others to take.
		const bool queued = _queue_size > 1 || orb_get_queue_size(_meta) > 1;

		if (advertised() && !queued) {
			unadvertise();
		}
	}

	orb_advert_t _handle{nullptr};
	const orb_id_t _meta;
	const unsigned _queue_size;
};

/** A publisher of instance 0, beside any others. */
template<typename T, uint8_t ORB_QSIZE = DefaultQueueSize<T>::value>
class Publication : public PublicationBase
{
public:
	Publication(ORB_ID id) : Publication(get_orb_meta(id)) {}
	Publication(const orb_metadata *meta) : PublicationBase(meta, ORB_QSIZE) {}

	/** Becomes a publisher without publishing anything yet. */
	bool advertise()
	{
		if (!advertised()) {
			_handle = orb_advertise_queue(get_topic(), nullptr, ORB_QSIZE);
		}

		return advertised();
	}

	bool publish(const T &data)
	{
		return advertise() && orb_publish(get_topic(), _handle, &data) == 0;
	}
};

/** A publication that has its message within. */
template<typename T>
class PublicationData : public Publication<T>
{
public:
	PublicationData(ORB_ID id) : Publication<T>(id) {}
	PublicationData(const orb_metadata *meta) : Publication<T>(meta) {}

	T &get() { return _data; }
	void set(const T &data) { _data = data; }

	bool update() { return Publication<T>::publish(_data); }

	bool update(const T &data)
	{
		_data = data;
		return update();
	}

private:
	T _data{};
};

} // namespace uORB

#endif // UORB_PUBLICATION_HPP
