#!/usr/bin/env bash
# Installations and surroundings that users have: each function is one, and prints what came out.
# Usage: tests/installs.sh [NAME...]; without a name, all that this machine has the interpreters and rights for.
# Each takes the installed tofmix of the active environment, but those that make an environment of their own.
# .ci/run runs `unprivileged` and `nowhere_to_write`.
set -euo pipefail
top=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
chmod 755 "$work"
trap 'rm -rf "$work"' EXIT
sample="$top/sample_data/three_boards.h5"

containers=(unprivileged nowhere_to_write)
installs=(uninstalled too_old_python wheel_with_extra checkout_with_extra other_pythons)

fail() { echo "FAULT: $*"; exit 1; }

# A command as a user of no rights, with no home, no entry of the user but `nobody`, and the variables that follow.
as_nobody() { env -i PATH="$PATH" HOME=/nonexistent setpriv --reuid=65534 --regid=65534 --clear-groups "$@"; }

# A folder that nobody may write to, as the output's.
open_folder() { mkdir -p "$1"; cp "$sample" "$1/a.h5"; chmod 777 "$1"; chmod 644 "$1/a.h5"; }

# --- containers: an installation that root made, and users of no rights

# An environment of its own, whose Python any user may run; `nobody` and its programs have to reach it.
for_nobody() {
  [ ! -x "$work/nobody/bin/tofmix" ] || return 0  # made by another function, and in PATH since
  local python
  for python in python3 /usr/bin/python3; do
    python=$(command -v "$python") || continue
    as_nobody env "$(readlink -f "$python")" -c '' 2> /dev/null || continue
    "$python" -m venv "$work/nobody" 2> /dev/null || continue
    "$work/nobody/bin/pip" install --quiet --no-compile "$top"  # the most part of it is never imported
    export PATH="$work/nobody/bin:$PATH"
    return
  done
  return 1
}

unprivileged() {  # a kernel that root compiled in site-packages serves other users; a read-only cache is read
  for_nobody || { echo "skipped: nobody can run none of the Pythons"; return; }
  local scene=(simulate three-boards --frames 2)  # one kernel, compiled in a few seconds
  env -u NUMBA_CACHE_DIR tofmix "${scene[@]}" -o "$work/root.h5" --overwrite
  ls -d "$work"/nobody/lib/python*/site-packages/__pycache__/tofmix-kernels-*
  open_folder "$work/unprivileged"
  (cd / && as_nobody tofmix "${scene[@]}" -o "$work/unprivileged/b.h5" 2> "$work/said") ||
    { cat "$work/said"; fail "a simulation of nobody failed"; }
  ! grep -i compil "$work/said" || fail "a kernel was compiled again"
  cmp "$work/root.h5" "$work/unprivileged/b.h5" || fail "another recording"
}

nowhere_to_write() {  # nothing can be written but the output's folder: compiled without a cache, said in one line
  for_nobody || { echo "skipped: nobody can run none of the Pythons"; return; }
  unshare --mount true 2> /dev/null || { echo "skipped: no right to make a mount namespace"; return; }
  rm -rf "$work"/nobody/lib/python*/site-packages/__pycache__/tofmix-kernels-*
  open_folder "$work/output"
  code=0
  unshare --mount bash -euo pipefail -c '
    mount --bind "$1" /mnt
    for folder in /tmp /var/tmp; do mount --bind "$folder" "$folder" && mount -o remount,ro,bind "$folder"; done
    cd /mnt && shift && "$@"' _ "$work/output" \
    env -i PATH="$PATH" HOME=/nonexistent setpriv --reuid=65534 --regid=65534 --clear-groups \
    tofmix estimate /mnt/a.h5 --refine none --mixing events --noise file 2> "$work/said" || code=$?
  cat "$work/said"
  [ "$code" = 0 ] || fail "exit $code"
  [ "$(grep -c NUMBA_CACHE_DIR "$work/said")" = 1 ] || fail "no single line names the remedy"
  [ "$(ls -A "$work/output" | tr '\n' ' ')" = "a.h5 a.layers.h5 " ] || fail "$(ls -A "$work/output")"
}

# --- installs

uninstalled() {  # nothing is left that could be imported
  python3 -m venv "$work/uninstalled"
  "$work/uninstalled/bin/pip" install --quiet "$top"
  "$work/uninstalled/bin/tofmix" estimate "$sample" -o "$work/uninstalled.h5" --overwrite
  "$work/uninstalled/bin/pip" uninstall --quiet --yes tofmix
  code=0; (cd / && "$work/uninstalled/bin/python" -c 'import tofmix') 2> "$work/said" || code=$?
  tail -n 1 "$work/said"; [ "$code" = 1 ] || fail "tofmix can still be imported"
}

too_old_python() {  # README's line under Python 3.10, with old versions of pip
  local python; python=$(interpreter 3.10) || { echo "skipped: no Python 3.10"; return; }
  for pip in 22.3 23.3; do
    rm -rf "$work/old" && "$python" -m venv "$work/old" && "$work/old/bin/pip" install --quiet "pip==$pip"
    local start=$SECONDS code=0
    "$work/old/bin/pip" install --quiet "$top" "$top[report]" 2> "$work/said" || code=$?
    tail -n 2 "$work/said"; echo "pip $pip: exit $code after $((SECONDS - start)) s"
    [ "$code" != 0 ] || fail "installed under Python 3.10"
    [ $((SECONDS - start)) -lt 60 ] || fail "it took $((SECONDS - start)) s to refuse"
  done
}

checkout_with_extra() {  # docs/how-to/cluster.md
  python3 -m venv "$work/checkout" && (cd "$top" && "$work/checkout/bin/pip" install --quiet '.[cluster]')
  "$work/checkout/bin/python" -c 'import distributed; print("distributed", distributed.__version__)'
}

wheel_with_extra() {  # likewise
  python3 -m venv "$work/wheel" && "$work/wheel/bin/pip" wheel --quiet --no-deps -w "$work" "$top"
  "$work/wheel/bin/pip" install --quiet "$(ls "$work"/tofmix-*.whl)[cluster]"
  "$work/wheel/bin/python" -c 'import distributed; print("distributed", distributed.__version__)'
}

interpreter() {  # path of a Python of this version that runs
  local found
  for found in "$(command -v "python$1" || true)" "$HOME/.pyenv/versions/$1".*/bin/python; do
    if [ -n "$found" ] && "$found" --version > /dev/null 2>&1; then echo "$found"; return; fi
  done
  return 1
}

other_pythons() {  # the main job under each other Python that there is: the same layers
  tofmix estimate "$sample" -o "$work/here.h5" --overwrite --quiet
  for version in 3.11 3.12 3.13 3.14; do
    local python; python=$(interpreter "$version") || { echo "skipped: no Python $version"; continue; }
    rm -rf "$work/other" && "$python" -m venv "$work/other" && "$work/other/bin/pip" install --quiet "$top"
    "$work/other/bin/tofmix" estimate "$sample" -o "$work/other.h5" --overwrite --quiet
    tofmix compare "$work/here.h5" "$work/other.h5" > /dev/null || fail "Python $version: other layers"
    echo "Python $version: the same layers"
  done
}

[ $# -gt 0 ] || set -- "${containers[@]}" "${installs[@]}"
for name in "$@"; do
  printf '\n== %s\n' "$name"
  "$name"
done
