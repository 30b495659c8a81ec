# shellcheck shell=sh
# Adds ManiSkill to .venv: requirements/maniskill.lock, and torch's build for CPUs. Read by ../vitac, which sets `root`.
#
# .venv/vitac-maniskill is written last and says what was added.

: "${root:?set by ../vitac}"
torch=2.13.0
maniskill_stamp=$root/.venv/vitac-maniskill

maniskill_fingerprint() {
  cat "$root/requirements/maniskill.lock" "$root/setup/maniskill.sh" | cksum | tr ' ' '-'
}

maniskill_is_ready() {
  [ -r "$maniskill_stamp" ] && [ "$(cat "$maniskill_stamp")" = "$(maniskill_fingerprint)" ]
}

# Where the usual build of torch is one for CUDA, that for CPUs has a version of its own, on an index of its own.
torch_for_cpus() {
  case "$(uname -s) $(uname -m)" in
    "Linux x86_64") echo "torch==$torch+cpu" ;;
    *) echo "torch==$torch" ;;
  esac
}

install_maniskill() {
  lock=$root/requirements/maniskill.lock
  : >"$log"
  heading="installing ManiSkill"
  logged "$heading" "$(grep -c '==' "$lock")" 'Collecting ' \
    pip install --require-hashes --only-binary :all: --no-deps -r "$lock" || fail_setup "$heading" 4000
  heading="installing torch for CPUs"
  if ! logged "$heading" '' '' pip install --only-binary :all: --no-deps "$(torch_for_cpus)"; then
    if in_log 'No matching distribution'; then
      end_steps "$heading failed"
      die "$(torch_for_cpus) is not on the package index that pip is configured for. Name the index that torch's own pages give for CPUs in PIP_EXTRA_INDEX_URL and run the command again."
    fi
    fail_setup "$heading" 4000
  fi
  maniskill_fingerprint >"$maniskill_stamp"
  end_steps "ManiSkill is ready"
}

# Adds ManiSkill to a .venv that `ensure_python` has made.
ensure_maniskill() {
  if maniskill_is_ready; then return; fi
  lock_setup "$venv/bin/python"
  if ! maniskill_is_ready; then
    say "ManiSkill, SAPIEN and torch for CPUs take 3 GB in $venv and are installed once; pictures need a Vulkan driver as well."
    if [ "$(free_mib)" -lt 4000 ]; then
      die "the disk has $(free_mib) MiB free in $root, expected 4000. Free some space and run the command again."
    fi
    install_maniskill
  fi
  unlock_setup
}
