#!/bin/sh
# Rewrites requirements/*.lock from pyproject.toml. Needs uv on the PATH (or its path in UV).
# Without arguments locked versions are kept if they still fit; `setup/lock.sh --upgrade` selects the newest.
set -eu

cd "$(dirname "$0")/.."

compile() { # output file, further arguments...
  output=$1
  shift
  "${UV:-uv}" pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-emit-index-url \
    --custom-compile-command setup/lock.sh --constraint requirements/bounds.in --output-file "$output" "$@" \
    pyproject.toml requirements/build.in
}

compile requirements/base.lock "$@"
compile requirements/server.lock --extra server --constraint requirements/base.lock "$@"
compile requirements/show.lock --extra show --constraint requirements/server.lock "$@"
compile requirements/dev.lock --extra server --extra show --extra station --extra telemetry --extra dev --constraint requirements/show.lock "$@"
compile requirements/station.lock --extra station --constraint requirements/dev.lock "$@"
compile requirements/data.lock --extra data --constraint requirements/dev.lock "$@"
compile requirements/maniskill.lock --extra maniskill --constraint requirements/dev.lock --override requirements/omitted.in "$@" requirements/torch.in
compile requirements/torch.lock --extra training --constraint requirements/maniskill.lock --override requirements/omitted.in "$@" requirements/torch.in
compile requirements/compat.lock --extra compat --constraint requirements/base.lock --override requirements/omitted.in "$@" requirements/torch.in requirements/compat.in
"${UV:-uv}" pip compile --quiet --universal --generate-hashes --python-version 3.11 --no-emit-index-url \
  --custom-compile-command setup/lock.sh --output-file requirements/node.lock "$@" requirements/node.in
python3 setup/package_sets.py
