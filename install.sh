#!/usr/bin/env bash
# Installs lipmetrics and all it needs into the folder .venv beside this file (or the folder given), and nothing elsewhere.
# On a Debian or Ubuntu machine without python3-venv it installs that package first, with sudo where needed.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
venv=${1:-.venv}

if ! python3 -c 'import ensurepip, venv' 2>/dev/null; then
    if ! command -v apt-get >/dev/null; then
        echo "install.sh: expected python3 with its venv module, found none; install Python 3.11 or newer, then run this again" >&2
        exit 2
    fi
    as_root=$([ "$(id -u)" = 0 ] || echo sudo)
    $as_root apt-get update -q
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q python3 python3-venv
fi
if ! python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
    echo "install.sh: expected Python 3.11 or newer, found $(python3 -V 2>&1); put a newer python3 first on the PATH" >&2
    exit 2
fi

[ -x "$venv/bin/pip" ] || python3 -m venv "$venv"
rm -rf build  # left by an earlier install, it would carry modules deleted since into the package
"$venv/bin/pip" install --quiet --disable-pip-version-check ".[test]"
echo "lipmetrics is installed: $venv/bin/lipmetrics --help"
