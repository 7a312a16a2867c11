# What `cmake --install` lays down: the library, its headers, and how find_package() and
# pkg-config find them.
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

set(package ${CMAKE_INSTALL_LIBDIR}/cmake/TinyKoop)
install(TARGETS tinykoop EXPORT TinyKoop ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
install(DIRECTORY ${PROJECT_SOURCE_DIR}/lib/include/ DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(EXPORT TinyKoop FILE TinyKoopConfig.cmake NAMESPACE TinyKoop:: DESTINATION ${package})
# before 1.0 a minor version may rename things
write_basic_package_version_file(${PROJECT_BINARY_DIR}/TinyKoopConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/TinyKoopConfigVersion.cmake DESTINATION ${package})

# relative to where the file lies, so that the installed tree can be moved
file(RELATIVE_PATH up /${CMAKE_INSTALL_LIBDIR}/pkgconfig /)
configure_file(${PROJECT_SOURCE_DIR}/cmake/tinykoop.pc.in ${PROJECT_BINARY_DIR}/tinykoop.pc @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/tinykoop.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
