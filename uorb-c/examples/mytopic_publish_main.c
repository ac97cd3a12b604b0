/*
 * The program around mytopic_publish.c: a number at the start and one each
 * second, or so many.
 */

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

void init();
void update_topic();

int main(int argc, char *argv[])
{
	int updates = argc > 1 ? atoi(argv[1]) : -1;
	init();
	puts("published");

	while (updates-- != 0) {
		sleep(1);
		update_topic();
	}

	return 0;
}
