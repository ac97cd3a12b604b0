/*
 * Seed 001. Mended:
 * - <stdio.h> and "color_counter.h" were missing
 * - the printed page breaks the program in two; the halves are joined
 */

#include <poll.h>
#include <stdio.h>
#include "color_counter.h"
ORB_DEFINE(color_timeouts, struct color_update);

void
subscriber(void)
{
    int      sub_red, sub_green, sub_blue;
    int      pub_timeouts;
    int      timeouts = 0;
    struct color_update cu;

    /* subscribe to color topics */
    sub_red = orb_subscribe(ORB_ID(color_red));
    sub_green = orb_subscribe(ORB_ID(color_green));
    sub_blue = orb_subscribe(ORB_ID(color_blue));

    /* advertise the timeout topic */
    cu.number = 0;
    pub_timeouts = orb_advertise(ORB_ID(color_timeouts), &cu);

    /* Loop waiting for updates */
    for(;;){

        /* wait for updates or a 1-second timeout */
        struct pollfd fds[3] = {
            { .fd = sub_red, .events = POLLIN },
            { .fd = sub_green, .events = POLLIN },
            { .fd = sub_blue, .events = POLLIN }
        };
        int ret = poll(fds, 3, 1000);

        /* check for a timeout */
        if(ret ==0){
            puts("timeout");
            cu.number=++timeouts;
            orb_publish(ORB_ID(color_timeouts), pub_timeouts,&cu);

        /* check for color updates */
        }else{

            if(fds[0].revents& POLLIN){
                orb_copy(ORB_ID(color_red), sub_red,&cu);
                printf("red is now %d\n",cu.number);
            }
            if(fds[1].revents& POLLIN){
                orb_copy(ORB_ID(color_green), sub_green,&cu);
                printf("green is now %d\n",cu.number);
            }
            if(fds[2].revents& POLLIN){
                orb_copy(ORB_ID(color_blue), sub_blue,&cu);
                printf("blue is now %d\n",cu.number);
            }
        }
    }
}
