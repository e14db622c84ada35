/* For a Windows library that is linked without a C runtime's start-up code and helpers: zig would
   have to compile those first, for a minute. What is left to do for ucrtbase.dll stands here. */

#if defined(NO_STARTUP)
#include <stdarg.h>
#include <stddef.h>

enum { STANDARD_SNPRINTF = 2 };

int _fltused = 1;

int __stdcall DllMainCRTStartup(void *library, unsigned long reason, void *reserved);
int __stdcall DllMainCRTStartup(void *library, unsigned long reason, void *reserved) {
    (void)library, (void)reason, (void)reserved;
    return 1;
}

/* What ucrtbase.dll has of snprintf; C headers make the rest of it. */
int __stdio_common_vsprintf(unsigned long long options, char *out, size_t size, const char *format,
                            void *locale, va_list arguments);

int snprintf(char *out, size_t size, const char *format, ...);
int snprintf(char *out, size_t size, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    int count = __stdio_common_vsprintf(STANDARD_SNPRINTF, out, size, format, NULL, arguments);
    va_end(arguments);
    return count;
}
#else
typedef int nothing_to_start; /* C99 asks for one declaration at least */
#endif
