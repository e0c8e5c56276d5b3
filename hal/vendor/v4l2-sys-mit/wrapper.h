#include <time.h>
#include <linux/videodev2.h>
