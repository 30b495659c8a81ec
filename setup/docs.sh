# shellcheck shell=sh
# Builds the documentation site in web/documentation, from docs/ and from what the code says of itself. Read by ../vitac, which sets
# `root`, after python.sh. The first build also runs the tutorial in miniature and draws the environments, with the physics, and keeps
# both until the code changes. Until the site is there the service runs all the same, and /docs says how it is built.

: "${root:?set by ../vitac}"
docs_stamp=$root/web/documentation/vitac-stamp

docs_fingerprint() {
  for folder in docs envs evaluator examples/peg_insertion_heuristic server/api server/views training; do
    find "$root/$folder" -type f ! -path "$root/docs/generated/*" ! -path "$root/docs/tutorials/*/tutorial_*" ! -name '*.pyc' 2>/dev/null || true
  done | sort | tr '\n' '\0' | xargs -0 cat "$root/requirements/docs.lock" | cksum | tr ' ' '-'
}

docs_are_built() {
  [ -r "$docs_stamp" ] && [ "$(cat "$docs_stamp")" = "$(docs_fingerprint)" ]
}

install_docs_packages() {
  read_stamp
  if installed_profile_covers dev; then return; fi
  logged "installing what builds the documentation" '' '' \
    pip install --retries 1 --timeout 10 --require-hashes --only-binary :all: --no-deps -r "$root/requirements/docs.lock"
}

# Replaces the site only once the new one is whole; any warning is an error.
build_docs() {
  built=$root/web/documentation.new
  rm -rf "$built"
  "$venv/bin/python" -m sphinx -W -q -b html -d "$venv/docs-doctrees" "$root/docs" "$built" || return 1
  rm -f "$built/.buildinfo" "$built/objects.inv"
  docs_fingerprint >"$built/vitac-stamp"
  rm -rf "$root/web/documentation"
  mv "$built" "$root/web/documentation"
}

# False, with the reason, if the build failed.
build_docs_under_lock() {
  lock_setup "$venv/bin/python"
  if ! docs_are_built; then
    started=$(date +%s)
    : >"$log"
    if install_docs_packages &&
      logged "building the documentation (its tutorial and pictures take up to a minute once)" '' '' build_docs; then
      end_steps "the documentation is ready ($(($(date +%s) - started)) s)"
    else
      note_failure documentation "$(docs_fingerprint)"
      unlock_setup
      end_steps "building the documentation failed; the reason is in $log. A start in an hour tries again."
      return 1
    fi
  fi
  unlock_setup
}

# False, with the reason, if the documentation cannot be built now; an older one stays.
docs_can_be_built() {
  can_set_up || return 1
  ! failed_lately documentation "$(docs_fingerprint)"
}

# False, with the reason, if the documentation cannot be built.
ensure_docs() {
  docs_are_built || { docs_can_be_built && build_docs_under_lock; }
}

# Lets the command start at once: the site is built beside it, and appears when it is whole. Ctrl-C does not stop the build, so that it
# is not begun again at each start. False, with the reason, if the documentation cannot be built now.
build_docs_meanwhile() {
  if docs_are_built; then return; fi
  docs_can_be_built || return 1
  say "building the documentation meanwhile; /docs shows it in a minute or two"
  (
    step() { :; } # the lines of the terminal belong to the command
    end_steps() { say "$*"; }
    build_docs_under_lock
  ) </dev/null >/dev/null &
}
