# Cortex-M4F as in the STM32F405, the chip of the Crazyflie and of many flight controllers.
set(CMAKE_SYSTEM_PROCESSOR cortex-m4)
set(TARGET_COMPILER arm-none-eabi-)
set(TARGET_FLAGS -mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16)
set(TARGET_QEMU qemu-system-arm -M netduinoplus2)
set(TARGET_FOLDER ${CMAKE_CURRENT_LIST_DIR})
include(${CMAKE_CURRENT_LIST_DIR}/../common/toolchain.cmake)
