# shellcheck shell=sh
# Adds to .venv what only some commands need: requirements/<name>.lock, for some with torch's build for CPUs. Read by ../vitac,
# which sets `root`.
#
# .venv/vitac-<name> is written last and says what was added.

: "${root:?set by ../vitac}"
torch=2.13.0

addition_title() { # name
  case $1 in
    data) echo "PyArrow, OpenCV and Minari" ;;
    maniskill) echo "ManiSkill" ;;
    station) echo "the station's software" ;;
    torch) echo "Stable-Baselines3" ;;
  esac
}

# What is said before anything is added.
addition_notice() { # name
  case $1 in
    data) echo "PyArrow, OpenCV and Minari take 400 MB in $venv and are installed once." ;;
    maniskill) echo "ManiSkill, SAPIEN and torch for CPUs take 3 GB in $venv and are installed once; pictures need a Vulkan driver as well." ;;
    station) echo "OpenCV and the drivers of a station's devices take 300 MB in $venv and are installed once." ;;
    torch) echo "torch for CPUs, Stable-Baselines3 and TensorBoard take 1 GB in $venv and are installed once." ;;
  esac
}

addition_mib() { # name
  case $1 in
    data) echo 500 ;;
    maniskill) echo 4000 ;;
    station) echo 400 ;;
    torch) echo 1500 ;;
  esac
}

addition_fingerprint() { # name
  cat "$root/requirements/$1.lock" "$root/setup/additions.sh" | cksum | tr ' ' '-'
}

addition_is_ready() { # name
  [ -r "$root/.venv/vitac-$1" ] && [ "$(cat "$root/.venv/vitac-$1")" = "$(addition_fingerprint "$1")" ]
}

# Where the usual build of torch is one for CUDA, that for CPUs has a version of its own, on an index of its own.
torch_for_cpus() {
  case "$(uname -s) $(uname -m)" in
    "Linux x86_64") echo "torch==$torch+cpu" ;;
    *) echo "torch==$torch" ;;
  esac
}

install_torch() { # name of the addition that needs it
  heading="installing torch for CPUs" # first, for PyPI has none for x86_64
  if ! logged "$heading" '' '' pip install --only-binary :all: --no-deps "$(torch_for_cpus)"; then
    if in_log 'No matching distribution'; then
      end_steps "$heading failed"
      die "$(torch_for_cpus) is not on the package index that pip is configured for. Nothing was added. Name the index that torch's own pages give for CPUs in PIP_EXTRA_INDEX_URL and run the command again."
    fi
    fail_setup "$heading" "$(addition_mib "$1")"
  fi
}

install_addition() { # name
  lock=$root/requirements/$1.lock
  : >"$log"
  case $1 in maniskill | torch) install_torch "$1" ;; esac
  heading="installing $(addition_title "$1")"
  logged "$heading" "$(grep -c '==' "$lock")" 'Collecting ' install_lock "$lock" || fail_setup "$heading" "$(addition_mib "$1")"
  addition_fingerprint "$1" >"$root/.venv/vitac-$1"
  end_steps "$(addition_title "$1") is ready"
}

# Adds something to a .venv that `ensure_python` has made.
ensure_addition() { # name
  if addition_is_ready "$1"; then return; fi
  lock_setup "$venv/bin/python"
  if ! addition_is_ready "$1"; then
    say "$(addition_notice "$1")"
    if [ "$(free_mib)" -lt "$(addition_mib "$1")" ]; then
      die "the disk has $(free_mib) MiB free in $root, expected $(addition_mib "$1"). Free some space and run the command again."
    fi
    install_addition "$1"
  fi
  unlock_setup
}
