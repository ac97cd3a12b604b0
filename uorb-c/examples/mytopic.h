/*
 * Seed 000, section 5. Mended:
 * - #include <uORB/uORB.h> was missing, which declares ORB_DECLARE
 */

#include <uORB/uORB.h>

/* 声明自定义主题，名字可以自定义，不过最好具有一定的意义，如下为随机产生整数数据 */
ORB_DECLARE(random_integer);

/* 定义要发布的数据结构体 */
struct random_integer_data {
    int r;
};
