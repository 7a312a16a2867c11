/* Stand-in for the firmware's header: only what the example needs. */
#pragma once

void appMain(void);
