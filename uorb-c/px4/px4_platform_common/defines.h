/**
 * @file px4_platform_common/defines.h
 *
 * Stands for PX4's header of this name: OK and ERROR, and mathematics in single
 * precision.
 */

#ifndef UORB_PX4_DEFINES_H
#define UORB_PX4_DEFINES_H

#include <sys/ioctl.h>

#include <visibility.h>

#define PX4_OK 0
#define PX4_ERROR (-1)

/* As NuttX has them. */
#define OK PX4_OK
#define ERROR PX4_ERROR

#ifdef __cplusplus
constexpr bool PX4_ISFINITE(float x) { return __builtin_isfinite(x); }
constexpr bool PX4_ISFINITE(double x) { return __builtin_isfinite(x); }
#else
# define PX4_ISFINITE(_x) __builtin_isfinite(_x)
#endif

#define M_E_F           2.71828183f
#define M_LOG2E_F       1.44269504f
#define M_LOG10E_F      0.43429448f
#define M_LN2_F         0.69314718f
#define M_LN10_F        2.30258509f
#define M_PI_F          3.14159265f
#define M_TWOPI_F       6.28318531f
#define M_PI_2_F        1.57079633f
#define M_PI_4_F        0.78539816f
#define M_3PI_4_F       2.35619449f
#define M_SQRTPI_F      1.77245385f
#define M_1_PI_F        0.31830989f
#define M_2_PI_F        0.63661977f
#define M_2_SQRTPI_F    1.12837917f
#define M_SQRT2_F       1.41421356f
#define M_SQRT1_2_F     0.70710678f
#define M_SQRT3_F       1.73205081f
#define M_DEG_TO_RAD_F  0.0174532925f
#define M_RAD_TO_DEG_F  57.2957795f
#define M_DEG_TO_RAD    0.017453292519943295
#define M_RAD_TO_DEG    57.29577951308232

#endif /* UORB_PX4_DEFINES_H */
