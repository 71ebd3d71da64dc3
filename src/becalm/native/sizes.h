/* The sizes of the kernel's arrays. Exported code has its own version of this file. */
#ifndef BECALM_SIZES_H
#define BECALM_SIZES_H

enum { N_MAX = 72 };    /* largest number of states */
enum { M_MAX = 32 };    /* largest number of channels that share one state */
enum { MODES_MAX = 8 }; /* largest number of modes */
enum { SMOOTHED = 64 }; /* number of rows in a block, which a smoother filters again as a whole */

/* Call a function whose first argument is the number of states; up to 7 it is a compile-time constant, so that loops
   are unrolled. */
#define FOR_STATES(n, function, ...)                       \
    switch (n) {                                           \
    case 1: function(1, __VA_ARGS__); break;               \
    case 2: function(2, __VA_ARGS__); break;               \
    case 3: function(3, __VA_ARGS__); break;               \
    case 4: function(4, __VA_ARGS__); break;               \
    case 5: function(5, __VA_ARGS__); break;               \
    case 6: function(6, __VA_ARGS__); break;               \
    case 7: function(7, __VA_ARGS__); break;               \
    default: function((int)(n), __VA_ARGS__);              \
    }

/* Do the same, with compile-time constants up to 4. */
#define FOR_FEW_STATES(n, function, ...)                   \
    switch (n) {                                           \
    case 1: function(1, __VA_ARGS__); break;               \
    case 2: function(2, __VA_ARGS__); break;               \
    case 3: function(3, __VA_ARGS__); break;               \
    case 4: function(4, __VA_ARGS__); break;               \
    default: function((int)(n), __VA_ARGS__);              \
    }

#endif
