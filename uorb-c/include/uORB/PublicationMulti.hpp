/**
 * @file PublicationMulti.hpp
 *
 * A publication of an instance of its own: PX4's classes of this name, over
 * uORB.h. The first advertise claims the lowest instance that nobody has, for
 * as long as the publication lives.
 */

#ifndef UORB_PUBLICATIONMULTI_HPP
#define UORB_PUBLICATIONMULTI_HPP

#include <uORB/Publication.hpp>

namespace uORB
{

/** The publisher of one instance. */
template<typename T, uint8_t QSIZE = DefaultQueueSize<T>::value>
class PublicationMulti : public PublicationBase
{
public:
	PublicationMulti(ORB_ID id) : PublicationMulti(get_orb_meta(id)) {}
	PublicationMulti(const orb_metadata *meta) : PublicationBase(meta, QSIZE) {}

	/** Claims an instance without publishing anything yet. */
	bool advertise()
	{
		if (!advertised()) {
			int instance = 0;
			_handle = orb_advertise_multi_queue(get_topic(), nullptr, &instance, QSIZE);
		}

		return advertised();
	}

	bool publish(const T &data)
	{
		return advertise() && orb_publish(get_topic(), _handle, &data) == 0;
	}

	/** The instance, which is claimed if it is not yet; -1 if there is none left. */
	int get_instance()
	{
		return advertise() ? orb_get_instance(_handle) : -1;
	}
};

/** A publication of an instance that has its message within. */
template<typename T>
class PublicationMultiData : public PublicationMulti<T>
{
public:
	PublicationMultiData(ORB_ID id) : PublicationMulti<T>(id) {}
	PublicationMultiData(const orb_metadata *meta) : PublicationMulti<T>(meta) {}

	T &get() { return _data; }
	void set(const T &data) { _data = data; }

	bool update() { return PublicationMulti<T>::publish(_data); }

	bool update(const T &data)
	{
		_data = data;
		return update();
	}

private:
	T _data{};
};

} // namespace uORB

#endif // UORB_PUBLICATIONMULTI_HPP
