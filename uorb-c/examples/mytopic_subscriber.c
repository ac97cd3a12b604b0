/*
 * Seed 000, section 5. Mended:
 * - <topic.h>, which the text calls mytopic.h
 * - <stdio.h> was missing, which declares printf
 * - init is void: it returned nothing
 */

#include <stdio.h>
#include "mytopic.h"

/* 订阅主题的句柄*/
static int topic_handle;

void init()
{
    /* 订阅主题 */
    topic_handle = orb_subscribe(ORB_ID(random_integer));
}

void check_topic()
{
    bool updated;
    struct random_integer_data rd;

    /* check to see whether the topic has updated since the last time we read it */
    orb_check(topic_handle, &updated);

    if (updated) {
        /* make a local copy of the updated data structure */
        orb_copy(ORB_ID(random_integer), topic_handle, &rd);
        printf("Random integer is now %d\n", rd.r);
    }
}
