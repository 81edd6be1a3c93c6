# Installed: library, headers, commands, and a package that a user's own CMake project finds:
#   find_package(pellucid REQUIRED)
#   target_link_libraries(mine PRIVATE pellucid::pellucid)      # #include "core/vec.hpp"
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)
set(PELLUCID_PACKAGE_DIR ${CMAKE_INSTALL_LIBDIR}/cmake/pellucid)

install(TARGETS pellucid EXPORT pellucid-targets ARCHIVE)
install(DIRECTORY lib/ DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/pellucid
        FILES_MATCHING PATTERN "vulkan/context.hpp" EXCLUDE
                       PATTERN "*.hpp" PATTERN "*_twin.h" PATTERN "twin.h")
install(EXPORT pellucid-targets NAMESPACE pellucid:: DESTINATION ${PELLUCID_PACKAGE_DIR})

configure_file(cmake/pellucid-config.cmake.in package/pellucid-config.cmake COPYONLY)
write_basic_package_version_file(${CMAKE_CURRENT_BINARY_DIR}/package/pellucid-config-version.cmake
                                 COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/package/pellucid-config.cmake
              ${CMAKE_CURRENT_BINARY_DIR}/package/pellucid-config-version.cmake
              cmake/FindNIFTI.cmake cmake/FindTeem.cmake
        DESTINATION ${PELLUCID_PACKAGE_DIR})
install(FILES LICENSE DESTINATION ${CMAKE_INSTALL_DOCDIR})
