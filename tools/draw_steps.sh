#!/bin/bash
# The pictures of scenes/STEP_BY_STEP.md, by the commands that stand there; -> scenes/pictures/.
set -eu
cd "$(dirname "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")")"
sed -n '/^```sh$/,/^```$/p' scenes/STEP_BY_STEP.md | grep -v '^```' >build/steps.sh
PATH=$PWD/build/release/bin:$PATH bash -eu build/steps.sh
