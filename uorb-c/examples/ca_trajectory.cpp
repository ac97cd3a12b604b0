/*
 * Seed 001, "step 2", where the page ends: what PX4's mavlink_receiver does with
 * a trajectory that arrives. Here it comes from the command line; and a reader.
 *
 *     ca_trajectory read [COUNT]
 *     ca_trajectory publish SEQ_ID
 */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <drivers/drv_hrt.h>
#include <px4_platform_common/posix.h>

#include "topics/ca_trajectory_msg.h"

/** As the seed declares it in mavlink_receiver.h. */
static orb_advert_t _ca_traj_msg_pub;

static bool handle_message_ca_trajectory_msg(uint16_t seq_id)
{
	ca_traj_struct_s trajectory{};
	trajectory.timestamp = hrt_absolute_time();
	trajectory.time_start_usec = trajectory.timestamp;
	trajectory.time_stop_usec = trajectory.timestamp + 1000000;
	trajectory.seq_id = seq_id;

	for (int i = 0; i < 28; i++) {
		trajectory.coefficients[i] = seq_id + i / 28.0f;
	}

	if (_ca_traj_msg_pub == nullptr) {
		_ca_traj_msg_pub = orb_advertise(ORB_ID(ca_trajectory_msg), &trajectory);
		return _ca_traj_msg_pub != nullptr;
	}

	return orb_publish(ORB_ID(ca_trajectory_msg), _ca_traj_msg_pub, &trajectory) == 0;
}

static int read_trajectories(int count)
{
	const int subscription = orb_subscribe(ORB_ID(ca_trajectory_msg));
	px4_pollfd_struct_t fds[1] = {};
	fds[0].fd = subscription;
	fds[0].events = POLLIN;

	while (subscription >= 0 && count != 0) {
		if (px4_poll(fds, 1, -1) < 0) {
			return 1;
		}

		ca_traj_struct_s trajectory;

		if (orb_copy(ORB_ID(ca_trajectory_msg), subscription, &trajectory) == 0) {
			printf("trajectory %d: %d us, coefficients %.3f to %.3f\n", trajectory.seq_id,
			       static_cast<int>(trajectory.time_stop_usec - trajectory.time_start_usec),
			       static_cast<double>(trajectory.coefficients[0]),
			       static_cast<double>(trajectory.coefficients[27]));
			fflush(stdout);
			count--;
		}
	}

	return orb_unsubscribe(subscription) == 0 ? 0 : 1;
}

int main(int argc, char *argv[])
{
	if (argc > 1 && strcmp(argv[1], "read") == 0) {
		return read_trajectories(argc > 2 ? atoi(argv[2]) : -1);
	}

	if (argc > 2 && strcmp(argv[1], "publish") == 0) {
		return handle_message_ca_trajectory_msg(static_cast<uint16_t>(atoi(argv[2]))) ? 0 : 1;
	}

	fprintf(stderr, "usage: ca_trajectory read [COUNT] | publish SEQ_ID\n");
	return 2;
}
