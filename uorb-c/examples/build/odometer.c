/*
 * A program of one's own messages beside those that are installed: it publishes
 * wheel_speed four times, once a wheel, reads it back, and looks whether there
 * is an acceleration.
 */

#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include <uORB/topics/sensor_accel.h>
#include <uORB/topics/wheel_speed.h>
#include <uORB/uORB.h>

/* Microseconds of the clock by which all time stamps are. */
static uint64_t now_us(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (uint64_t)now.tv_sec * 1000000 + (uint64_t)now.tv_nsec / 1000;
}

int main(void)
{
	int accel_sub = orb_subscribe(ORB_ID(sensor_accel));
	int speed_sub = orb_subscribe(ORB_ID(wheel_speed));
	orb_advert_t speed_pub = orb_advertise(ORB_ID(wheel_speed), NULL);

	if (accel_sub < 0 || speed_sub < 0 || speed_pub < 0) {
		fprintf(stderr, "odometer: %s\n", strerror(errno));
		return 1;
	}

	for (uint8_t wheel = 0; wheel < WHEEL_SPEED_WHEELS; wheel++) {
		struct wheel_speed_s speed = {.timestamp = now_us(), .speed = 10.0f + wheel, .wheel = wheel};

		orb_publish(ORB_ID(wheel_speed), speed_pub, &speed);
	}

	/* A subscription is a file descriptor, readable while there is something new. */
	struct pollfd waiting = {.fd = speed_sub, .events = POLLIN};

	while (poll(&waiting, 1, 0) > 0) {
		struct wheel_speed_s speed;

		orb_copy(ORB_ID(wheel_speed), speed_sub, &speed);
		printf("wheel %d: %.1f rad/s\n", speed.wheel, (double)speed.speed);
	}

	struct sensor_accel_s accel;

	if (orb_copy(ORB_ID(sensor_accel), accel_sub, &accel) == 0) {
		printf("acceleration: %.2f %.2f %.2f m/s^2\n", (double)accel.x, (double)accel.y, (double)accel.z);
	} else {
		printf("no acceleration yet\n");
	}

	orb_unadvertise(speed_pub);
	orb_unsubscribe(speed_sub);
	orb_unsubscribe(accel_sub);
	return 0;
}
