# Tests of what a stranger touches: the installed package, the two commands, the report.
# The sanitizer builds leave them out: they would test the same things again.
if(PELLUCID_SANITIZE)
    return()
endif()

# A user's own project, built against a fresh install.
set(PELLUCID_PREFIX ${CMAKE_BINARY_DIR}/package/prefix)
add_test(NAME Package.Installs
         COMMAND ${CMAKE_COMMAND} --install ${CMAKE_BINARY_DIR} --prefix ${PELLUCID_PREFIX})
add_test(NAME Package.IsFoundByAUsersProject
         COMMAND ${CMAKE_CTEST_COMMAND}
                 --build-and-test ${CMAKE_CURRENT_SOURCE_DIR}/tests/package ${CMAKE_BINARY_DIR}/package/consumer
                 --build-generator ${CMAKE_GENERATOR} --build-noclean
                 --build-options -DCMAKE_PREFIX_PATH=${PELLUCID_PREFIX} -DCMAKE_CXX_COMPILER=${CMAKE_CXX_COMPILER}
                 --test-command ${CMAKE_BINARY_DIR}/package/consumer/consumer)
set_tests_properties(Package.Installs PROPERTIES LABELS package FIXTURES_SETUP package)
set_tests_properties(Package.IsFoundByAUsersProject PROPERTIES LABELS package FIXTURES_REQUIRED package TIMEOUT 300)

# The scenes that come with the program.
add_test(NAME Scenes.LoadAndRender
         COMMAND bash ${CMAKE_CURRENT_SOURCE_DIR}/tests/scenes_test.sh $<TARGET_FILE:render>)
set_tests_properties(Scenes.LoadAndRender PROPERTIES LABELS commands TIMEOUT 300)

# The two commands, on experiments that are shell scripts; the report and the figure style.
# The python3 on the PATH may know nothing of Debian's packages.
set(PELLUCID_PYTHON "" CACHE STRING "A python3 that imports numpy, scipy, pandas, matplotlib and PIL; found where empty")
set(python ${PELLUCID_PYTHON})
foreach(candidate python3 /usr/bin/python3)
    if(NOT python)
        execute_process(COMMAND ${candidate} -c "import numpy, scipy, pandas, matplotlib, PIL"
                        RESULT_VARIABLE cannot_import OUTPUT_QUIET ERROR_QUIET)
        if(cannot_import EQUAL 0)
            set(python ${candidate})
        endif()
    endif()
endforeach()
if(NOT python)
    message(WARNING "no python3 imports numpy, scipy, pandas, matplotlib and PIL: "
                    "the commands and the report are not tested")
    return()
endif()
add_test(NAME Commands.KeepTheirContract COMMAND bash ${CMAKE_CURRENT_SOURCE_DIR}/tests/commands_test.sh)
add_test(NAME Analysis.KeepsItsContract
         COMMAND ${python} -B ${CMAKE_CURRENT_SOURCE_DIR}/tests/analysis_test.py)
set_tests_properties(Commands.KeepTheirContract Analysis.KeepsItsContract PROPERTIES
                     LABELS commands TIMEOUT 120 ENVIRONMENT "PYTHON=${python}")
