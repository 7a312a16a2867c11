# Cortex-M7 with a double-precision FPU, as in the STM32H7 and i.MX RT.
set(CMAKE_SYSTEM_PROCESSOR cortex-m7)
set(TARGET_COMPILER arm-none-eabi-)
set(TARGET_FLAGS -mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16)
set(TARGET_QEMU qemu-system-arm -M mps2-an500)
set(TARGET_FOLDER ${CMAKE_CURRENT_LIST_DIR})
include(${CMAKE_CURRENT_LIST_DIR}/../common/toolchain.cmake)
