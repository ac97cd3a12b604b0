/* A topic with as many values as -DVALUES says: two programs that were built from
 * different texts. Advertises until its stdin closes, or subscribes. */

#include <errno.h>
#include <stdio.h>
#include <string.h>

#include <uORB/uORB.h>

struct disputed_data {
	int values[VALUES];
};
ORB_DEFINE(disputed);

int main(int argc, char *argv[])
{
	const bool subscribes = argc > 1 && strcmp(argv[1], "subscribe") == 0;
	const int handle = subscribes ? orb_subscribe(ORB_ID(disputed)) : orb_advertise(ORB_ID(disputed), NULL);
	puts(handle >= 0 ? "ok" : errno == EINVAL ? "EINVAL" : strerror(errno));
	fflush(stdout);
	return handle >= 0 ? getchar() != EOF : 1;
}
