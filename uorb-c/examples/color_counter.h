/*
 * Seed 001. Mended:
 * - #include <uORB/uORB.h> was missing, which declares ORB_DECLARE
 */

#include <uORB/uORB.h>

ORB_DECLARE(color_red);
ORB_DECLARE(color_green);
ORB_DECLARE(color_blue);
ORB_DECLARE(color_timeouts);
/* structure published to color_red, color_green, color_blue and color_timeouts */
struct color_update
{
    int number;
};
