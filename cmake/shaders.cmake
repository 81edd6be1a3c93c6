# Shaders: lib/vulkan/shaders/NAME.comp.glsl (and those of the probes in bench/) becomes the words of its
# SPIR-V in generated/shaders/NAME.comp.inc, which C++ includes between braces: #include
# "shaders/NAME.comp.inc"; NAME.vert.glsl and NAME.frag.glsl alike. They include twin headers as C++ does:
# #include "kernel/NAME_twin.h". What several shaders share is NAME.glsl: #include "vulkan/shaders/NAME.glsl".
find_program(GLSLC glslc REQUIRED)
file(GLOB PELLUCID_SHADERS CONFIGURE_DEPENDS ${CMAKE_CURRENT_SOURCE_DIR}/lib/vulkan/shaders/*.comp.glsl
     ${CMAKE_CURRENT_SOURCE_DIR}/lib/vulkan/shaders/*.vert.glsl ${CMAKE_CURRENT_SOURCE_DIR}/lib/vulkan/shaders/*.frag.glsl
     ${CMAKE_CURRENT_SOURCE_DIR}/bench/*.comp.glsl ${CMAKE_CURRENT_SOURCE_DIR}/bench/*.vert.glsl
     ${CMAKE_CURRENT_SOURCE_DIR}/bench/*.frag.glsl)
set(shader_words)
foreach(source ${PELLUCID_SHADERS})
    string(REGEX REPLACE "^.*/([^/]*)\\.(comp|vert|frag)\\.glsl$" "\\1.\\2" name ${source})
    string(REGEX REPLACE "^.*\\." "" stage ${name})
    set(words ${CMAKE_BINARY_DIR}/generated/shaders/${name}.inc)
    add_custom_command(OUTPUT ${words} DEPENDS ${source} DEPFILE ${words}.d VERBATIM
        COMMAND ${CMAKE_COMMAND} -E make_directory ${CMAKE_BINARY_DIR}/generated/shaders
        COMMAND ${GLSLC} --target-env=vulkan1.3 -fshader-stage=${stage} -O -Werror -mfmt=num
                -MD -MF ${words}.d -MT ${words} -I ${CMAKE_CURRENT_SOURCE_DIR}/lib ${source} -o ${words}
        COMMENT "Shader ${name}")
    list(APPEND shader_words ${words})
endforeach()
add_custom_target(pellucid_shaders DEPENDS ${shader_words})
add_dependencies(pellucid pellucid_shaders)
