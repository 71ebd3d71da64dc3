/* How large a kernel's arrays are. What is exported has a file of its own in the place of this one. */
#ifndef BECALM_SIZES_H
#define BECALM_SIZES_H

enum { N_MAX = 72 };    /* states that a filter has, at the most */
enum { M_MAX = 32 };    /* channels of one state that are filtered together, at the most */
enum { MODES_MAX = 8 };
enum { SMOOTHED = 64 }; /* rows that are filtered at once, and by a smoother again */

/* Call a function whose first argument is the number of states: a constant up to 7, so that every loop is unrolled. */
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

/* The same, up to 4. */
#define FOR_FEW_STATES(n, function, ...)                   \
    switch (n) {                                           \
    case 1: function(1, __VA_ARGS__); break;               \
    case 2: function(2, __VA_ARGS__); break;               \
    case 3: function(3, __VA_ARGS__); break;               \
    case 4: function(4, __VA_ARGS__); break;               \
    default: function((int)(n), __VA_ARGS__);              \
    }

#endif
