/**
 * @file visibility.h
 *
 * Stands for PX4's src/include/visibility.h, which PX4's build includes before
 * every file: what is exported, and C's names in C++.
 */

#ifndef UORB_PX4_VISIBILITY_H
#define UORB_PX4_VISIBILITY_H

#ifndef __EXPORT
# define __EXPORT __attribute__((visibility("default")))
#endif

#ifndef __PRIVATE
# define __PRIVATE __attribute__((visibility("hidden")))
#endif

/* The C library may have these two already. */
#ifndef __BEGIN_DECLS
# ifdef __cplusplus
#  define __BEGIN_DECLS extern "C" {
#  define __END_DECLS }
# else
#  define __BEGIN_DECLS
#  define __END_DECLS
# endif
#endif

#endif /* UORB_PX4_VISIBILITY_H */
