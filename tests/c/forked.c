/* What the handles of a process are worth in its child, and the child's own. */

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include <uORB/uORB.h>
#include <px4_platform_common/posix.h>

struct inherited_data {
	int value;
};
ORB_DEFINE(inherited);

static int failures;

static void check(const char *what, int holds)
{
	if (!holds) {
		printf("%s: %s\n", what, strerror(errno));
		failures++;
	}
}

static int value_of(int sub)
{
	struct inherited_data data = {-1};
	return orb_copy(ORB_ID(inherited), sub, &data) == 0 ? data.value : -1;
}

static int in_child(int parents_sub, orb_advert_t parents_pub)
{
	struct inherited_data data = {2};
	px4_pollfd_struct_t fd = {parents_sub, POLLIN, 0};

	check("the parent's subscription is copied", value_of(parents_sub) == 1);
	errno = 0;
	check("the parent's publication is the parent's",
	      orb_publish(ORB_ID(inherited), parents_pub, &data) == -1 && errno == EPERM);
	errno = 0;
	check("waiting on the parent's subscription is, too",
	      px4_poll(&fd, 1, -1) == -1 && errno == EPERM);

	const int sub = orb_subscribe(ORB_ID(inherited));
	check("the child subscribes", sub >= 0);
	check("and copies", value_of(sub) == 1);
	const orb_advert_t pub = orb_advertise(ORB_ID(inherited), &data);
	check("the child advertises", pub > 0 && pub != parents_pub);
	fd.fd = sub;
	check("and hears itself", px4_poll(&fd, 1, -1) == 1 && value_of(sub) == 2);
	/* What it gives back of the parent's stays the parent's. */
	check("the child unsubscribes for itself", orb_unsubscribe(parents_sub) == 0);
	check("and unadvertises", orb_unadvertise(parents_pub) == 0 && orb_unadvertise(pub) == 0);
	return failures;
}

int main(void)
{
	struct inherited_data data = {1};
	const int sub = orb_subscribe(ORB_ID(inherited));
	const orb_advert_t pub = orb_advertise(ORB_ID(inherited), &data);
	check("the parent subscribes and advertises", sub >= 0 && pub > 0);
	check("and copies", value_of(sub) == 1);
	fflush(stdout);

	const pid_t child = fork();

	if (child == 0) {
		const int failed = in_child(sub, pub);
		fflush(stdout);
		_exit(failed);
	}

	int status;
	check("the child ends well", waitpid(child, &status, 0) == child && status == 0);

	px4_pollfd_struct_t fd = {sub, POLLIN, 0};
	check("the parent hears the child", px4_poll(&fd, 1, -1) == 1 && value_of(sub) == 2);
	data.value = 3;
	check("and publishes on", orb_publish(ORB_ID(inherited), pub, &data) == 0);
	check("and hears itself", px4_poll(&fd, 1, -1) == 1 && value_of(sub) == 3);
	check("and is still advertised", orb_exists(ORB_ID(inherited), 0) == 0);
	return failures;
}
