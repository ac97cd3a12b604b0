/*
 * Seed 000, section 5. Mended:
 * - <topic.h>, which the text calls mytopic.h
 * - <stdlib.h> was missing, which declares random
 * - init and update_topic are void: they returned nothing
 */

#include <stdlib.h>
#include "mytopic.h"
/* 定义主题 */
ORB_DEFINE(random_integer);

/* 待发布的主题句柄 */
static int topic_handle;

// 初始化发布数据  公告主题
void init()
{
    /* 随机产生一个数初始化数据结构体 */
    struct random_integer_data rd = { .r = random(), };

    /* 公告主题 */
    topic_handle = orb_advertise(ORB_ID(random_integer), &rd);
}
// 发布主题数据
void update_topic()
{
    /* 产生新的数据 */
    struct random_integer_data rd = { .r = random(), };

    /* 发布主题，更新数据 */
    orb_publish(ORB_ID(random_integer), topic_handle, &rd);
}
