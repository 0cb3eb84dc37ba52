/// string.h of a target without a C library: what the apps and the compilers call, in memory.c.
#ifndef SPINDECK_BOARD_STRING_H
#define SPINDECK_BOARD_STRING_H

#include <stddef.h>

void *memchr(const void *in, int value, size_t size);
int memcmp(const void *a, const void *b, size_t size);
void *memcpy(void *restrict to, const void *restrict from, size_t size);
void *memmove(void *to, const void *from, size_t size);
void *memset(void *to, int value, size_t size);
size_t strlen(const char *text);

#endif
