# shellcheck shell=sh
# Keeps .venv as requirements/*.lock and pyproject.toml say. Read by ../vitac, which sets `root`.
#
# .venv/vitac-stamp is written last and holds what was installed: `<profile> <fingerprint> <place> <interpreter>`. No
# stamp means a set-up that was cut off, and .venv is made anew, as after a move of the folder or of the interpreter; an
# outdated fingerprint means an update in place.

: "${root:?set by ../vitac}"
venv=$root/.venv
stamp=$venv/vitac-stamp
oldest_python=11
newest_python=14

fingerprint() {
  cat "$root/pyproject.toml" "$root"/requirements/*.lock "$root/setup/python.sh" | cksum | tr ' ' '-'
}

place() {
  printf '%s' "$root" | cksum | tr ' ' '-'
}

read_stamp() {
  has_profile='' has_fingerprint='' has_place='' has_interpreter=''
  if [ -r "$stamp" ]; then
    read -r has_profile has_fingerprint has_place has_interpreter <"$stamp" || true
  fi
}

# True where .venv was completed here and still points to the interpreter that it was made with.
venv_stands() {
  [ "$has_place" = "$(place)" ] && [ -x "$venv/bin/python" ] && [ "$(readlink -f "$venv/bin/python")" = "$has_interpreter" ]
}

# Each profile holds all packages of the ones before it.
profile_rank() { # profile
  case $1 in
    base) echo 1 ;;
    show) echo 2 ;;
    dev) echo 3 ;;
    *) echo 0 ;;
  esac
}

installed_profile_covers() { # profile
  [ "$(profile_rank "$has_profile")" -ge "$(profile_rank "$1")" ]
}

python_is_ready() { # profile
  read_stamp
  venv_stands && [ "$has_fingerprint" = "$(fingerprint)" ] && [ -x "$venv/bin/vitac" ] && installed_profile_covers "$1"
}

# Sets `python` to an interpreter that can make a virtual environment, newest first, or ends with what is missing.
find_python() {
  without_venv='' other=''
  probe='
import sys
minor = sys.version_info[1] if sys.version_info[0] == 3 else 0
if not int(sys.argv[1]) <= minor <= int(sys.argv[2]):
    print("version %d.%d" % sys.version_info[:2])
else:
    try:
        import ensurepip, venv
    except ImportError:
        print("venv %d.%d" % sys.version_info[:2])
    else:
        print("ready")
'
  if [ -n "${VITAC_PYTHON-}" ]; then
    set -- "$VITAC_PYTHON"
  else
    set -- python3.14 python3.13 python3.12 python3.11 python3
  fi
  for python in "$@"; do
    answer=$("$python" -I -c "$probe" "$oldest_python" "$newest_python" 2>/dev/null) || continue
    case $answer in
      ready) return ;;
      venv*) without_venv=${without_venv:-${answer#venv }} ;;
      *) other="$other $python is ${answer#version }." ;;
    esac
  done
  if [ -n "$without_venv" ]; then
    die "Python $without_venv is here without its venv module. Install it (Debian and Ubuntu: apt-get install python3-venv) and run the command again."
  fi
  die "needs Python 3.$oldest_python to 3.$newest_python and found none among $*.${other} Install one (Debian and Ubuntu: apt-get install python3 python3-venv) or name it in VITAC_PYTHON."
}

pip() {
  "$venv/bin/python" -I -m pip --disable-pip-version-check --no-input "$@"
}

# Symlinks `.dev/vitac/<folder>`, so that type checkers find `vitac.<folder>` where it is.
link_packages() {
  mkdir -p "$root/.dev/vitac"
  sed -n 's/^"vitac\.[a-z_]*" = "\([a-z_]*\)"$/\1/p' "$root/pyproject.toml" | while read -r folder; do
    ln -sfn "../../$folder" "$root/.dev/vitac/$folder"
  done
}

install_python() { # profile
  started=$(date +%s)
  lock=$root/requirements/$1.lock
  : >"$log"
  if venv_stands; then
    rm -f "$stamp"
  else
    rm -rf "$venv"
    logged "making .venv with $python" '' '' "$python" -I -m venv "$venv" || fail_setup "making .venv" 1000
  fi
  heading="installing Python packages"
  logged "$heading" "$(grep -c '==' "$lock")" 'Collecting ' \
    pip install --require-hashes --only-binary :all: --no-deps -r "$lock" || fail_setup "$heading" 1000
  logged "installing ViTac Arena" '' '' \
    pip install --no-index --no-deps --no-build-isolation -e "$root" || fail_setup "installing ViTac Arena" 1000
  link_packages
  printf '%s %s %s %s\n' "$1" "$(fingerprint)" "$(place)" "$(readlink -f "$venv/bin/python")" >"$stamp.new"
  mv "$stamp.new" "$stamp"
  end_steps "Python packages are ready ($(($(date +%s) - started)) s)"
}

# Makes .venv hold the packages of a profile: `base` to evaluate and serve, `show` to draw, `dev` to test as well.
ensure_python() { # profile
  # Settings meant for other installations would send packages past .venv.
  unset PIP_TARGET PIP_PREFIX PIP_ROOT PYTHONHOME
  export PIP_USER=0
  if python_is_ready "$1"; then return; fi
  find_python
  lock_setup "$python"
  if ! python_is_ready "$1"; then
    profile=$1
    if venv_stands && installed_profile_covers "$1"; then profile=$has_profile; fi
    install_python "$profile"
  fi
  unlock_setup
}
