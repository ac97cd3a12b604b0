/**
 * @file px4_log.h
 *
 * The name that px4_platform_common/log.h had from 2015 to 2019.
 */

#ifndef UORB_PX4_OLD_LOG_H
#define UORB_PX4_OLD_LOG_H

#include <px4_platform_common/log.h>

#endif /* UORB_PX4_OLD_LOG_H */
