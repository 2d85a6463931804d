#!/usr/bin/env bash
# A PostgreSQL of one's own, for tests.
#   postgres.sh start DIR    installs Debian's package if need be, makes a cluster, starts it, prints its URL
#   postgres.sh resume DIR   starts it again after a stop or a kill, on the same port
#   postgres.sh stop DIR     at once, as a machine that fails would
set -euo pipefail
[ $# = 2 ] || { echo "usage: $0 start|resume|stop DIR" >&2; exit 2; }
mkdir -p "$2"
DIR=$(cd "$2" && pwd -P)

install() {
  ls -d /usr/lib/postgresql/*/bin >/dev/null 2>&1 && return
  # The package would start a cluster of its own.
  local policy=/usr/sbin/policy-rc.d made=
  [ -e $policy ] || { printf '#!/bin/sh\nexit 101\n' >$policy; chmod +x $policy; made=yes; }
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends postgresql >/dev/null
  [ -z "$made" ] || rm -f $policy
}

as_postgres() {  # PostgreSQL refuses to run as root
  if [ "$(id -u)" = 0 ]; then
    (cd / && setpriv --reuid=postgres --regid=postgres --init-groups env LC_ALL=C HOME=/tmp "$@")
  else
    env LC_ALL=C "$@"
  fi
}

resume() {
  local bin; bin=$(ls -d /usr/lib/postgresql/*/bin | tail -1)
  as_postgres "$bin/pg_ctl" -D "$(cat "$DIR/data")" -l "$(cat "$DIR/data")/log" -w -t 60 -s -o "-p $(cat "$DIR/port")" start
}

start() {
  install
  local bin data; bin=$(ls -d /usr/lib/postgresql/*/bin | tail -1)
  data=$(mktemp -d /tmp/postgres.XXXXXX)  # a folder that the user postgres can walk into
  [ "$(id -u)" != 0 ] || chown postgres:postgres "$data"
  echo "$data" >"$DIR/data"
  echo $((20000 + RANDOM % 10000)) >"$DIR/port"
  as_postgres "$bin/initdb" -D "$data" -U postgres -A trust -E UTF8 --locale=C -N >/dev/null
  as_postgres tee -a "$data/postgresql.conf" >/dev/null <<CONF
listen_addresses = '127.0.0.1'
unix_socket_directories = ''
fsync = off
max_connections = 200
CONF
  resume
  echo "postgresql://postgres@127.0.0.1:$(cat "$DIR/port")/postgres"
}

stop() {
  local bin; bin=$(ls -d /usr/lib/postgresql/*/bin | tail -1)
  as_postgres "$bin/pg_ctl" -D "$(cat "$DIR/data")" -m immediate -s stop
}

case $1 in start | resume | stop) "$1" ;; *) echo "start, resume or stop" >&2; exit 2 ;; esac
