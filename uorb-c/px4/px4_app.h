/**
 * @file px4_app.h
 *
 * The name that px4_platform_common/app.h had from 2015 to 2019.
 */

#ifndef UORB_PX4_OLD_APP_H
#define UORB_PX4_OLD_APP_H

#include <px4_platform_common/app.h>

#endif /* UORB_PX4_OLD_APP_H */
