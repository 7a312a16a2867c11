# Cortex-M55 with Helium vectors, in float and integer.
set(CMAKE_SYSTEM_PROCESSOR cortex-m55)
set(TARGET_COMPILER arm-none-eabi-)
set(TARGET_FLAGS -mcpu=cortex-m55 -mthumb -mfloat-abi=hard)
set(TARGET_QEMU qemu-system-arm -M mps3-an547)
set(TARGET_FOLDER ${CMAKE_CURRENT_LIST_DIR})
include(${CMAKE_CURRENT_LIST_DIR}/../common/toolchain.cmake)
