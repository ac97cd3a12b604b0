/*
 * Seed 002: the definition of a topic as PX4 1.11 to 1.14 generated it, with five
 * arguments, and a program that shows what it has defined. Mended:
 * - the text's "sizeof ... is 28": that is the size without padding. The struct
 *   has 32 bytes, the last four of them padding
 *
 *     vehicle_acceleration          publishes one, copies it and prints it
 */

#include <stdio.h>

#include <uORB/uORB.h>
#include <uORB/topics/vehicle_acceleration.h>
#include <uORB/topics/uORBTopics.hpp>

constexpr char __orb_vehicle_acceleration_fields[] = "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;uint8_t[4] _padding0;";

ORB_DEFINE(vehicle_acceleration, struct vehicle_acceleration_s, 28, __orb_vehicle_acceleration_fields, static_cast<uint8_t>(ORB_ID::vehicle_acceleration));

int main()
{
	const orb_metadata *meta = ORB_ID(vehicle_acceleration);
	printf("%s: %d bytes, %d without padding, id %d\n%s\n", meta->o_name, meta->o_size, meta->o_size_no_padding,
	       meta->o_id, meta->o_fields);

	const int subscription = orb_subscribe(meta);
	vehicle_acceleration_s acceleration{};
	acceleration.xyz[2] = -9.81f;
	const orb_advert_t publication = orb_advertise(meta, &acceleration);
	vehicle_acceleration_s copied{};

	if (publication == nullptr || orb_copy(meta, subscription, &copied) != 0) {
		return 1;
	}

	printf("x %.2f, y %.2f, z %.2f\n", static_cast<double>(copied.xyz[0]), static_cast<double>(copied.xyz[1]),
	       static_cast<double>(copied.xyz[2]));
	return orb_unadvertise(publication) == 0 && orb_unsubscribe(subscription) == 0 ? 0 : 1;
}
