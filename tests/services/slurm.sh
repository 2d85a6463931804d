#!/usr/bin/env bash
# A real SLURM of one node, by hand: no systemd, no accounting, nothing in /etc. For tests.
#   slurm.sh start DIR   installs Debian's packages if need be, starts munged, slurmctld and slurmd, prints an export line
#   slurm.sh stop DIR    ends the jobs and the three daemons
set -euo pipefail
export PATH=$PATH:/usr/sbin:/sbin
[ $# = 2 ] || { echo "usage: $0 start|stop DIR" >&2; exit 2; }
mkdir -p "$2"
DIR=$(cd "$2" && pwd -P)
export SLURM_CONF=$DIR/slurm.conf

install() {
  command -v slurmctld >/dev/null && command -v munged >/dev/null && return
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends slurm-wlm munge >/dev/null
}

daemon() {  # NAME COMMAND...: in the background, its process noted
  setsid nohup "${@:2}" >"$DIR/$1.out" 2>&1 </dev/null &
  echo $! >"$DIR/$1.pid"
}

port() {  # one that is free, below those that the kernel hands out
  local try
  while try=$((20000 + RANDOM % 10000)); (exec 3<>"/dev/tcp/127.0.0.1/$try") 2>/dev/null; do :; done
  echo "$try"
}

configure() {
  local host; host=$(hostname -s)
  # pgid: a cancelled job ends with its children. cred_expire: a requeued job starts again no sooner than that.
  cat >"$SLURM_CONF" <<CONF
ClusterName=test
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$(port)
SlurmdPort=$(port)
SlurmUser=$(id -un)
SlurmdUser=$(id -un)
AuthInfo=socket=$DIR/munge/socket,cred_expire=5
StateSaveLocation=$DIR/state
SlurmdSpoolDir=$DIR/spool
SlurmctldPidFile=$DIR/state/slurmctld.pid
SlurmdPidFile=$DIR/state/slurmd.pid
SlurmctldLogFile=$DIR/slurmctld.log
SlurmdLogFile=$DIR/slurmd.log
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
ProctrackType=proctrack/pgid
TaskPlugin=task/none
MpiDefault=none
MailProg=/bin/true
SchedulerParameters=batch_sched_delay=0,sched_interval=2,bf_interval=2
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
JobRequeue=1
ReturnToService=2
KillWait=2
MinJobAge=10
SlurmdParameters=config_overrides
NodeName=$host NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN
PartitionName=main Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
  echo "CgroupPlugin=disabled" >"$DIR/cgroup.conf"
  [ "$(slurmd -V | tr -dc '0-9.' | cut -d. -f1)" -ge 23 ] || : >"$DIR/cgroup.conf"
}

start() {
  install
  stop
  rm -rf "$DIR/state" "$DIR/spool" "$DIR/munge"
  mkdir -p "$DIR/state" "$DIR/spool" "$DIR/munge"
  chmod 755 "$DIR" "$DIR/munge"
  (umask 077; head -c 128 /dev/urandom >"$DIR/munge/key")
  daemon munged munged -F --force --key-file="$DIR/munge/key" --socket="$DIR/munge/socket" \
    --pid-file="$DIR/munge/pid" --seed-file="$DIR/munge/seed" --log-file="$DIR/munged.log"
  configure
  daemon slurmctld slurmctld -D -i -f "$SLURM_CONF"
  daemon slurmd slurmd -D -f "$SLURM_CONF"
  for _ in $(seq 150); do
    [ "$(timeout 5 sinfo -h -o %T 2>/dev/null)" = idle ] && { echo "export SLURM_CONF=$SLURM_CONF"; return; }
    sleep 0.2
  done
  tail -n 20 "$DIR"/*.log "$DIR"/*.out >&2
  stop
  echo "the cluster did not come up" >&2
  exit 1
}

stop() {
  timeout 10 scancel --user="$(id -un)" 2>/dev/null || true
  for _ in $(seq 40); do [ -z "$(timeout 5 squeue -h 2>/dev/null)" ] && break; sleep 0.25; done
  local name pid
  for name in slurmd slurmctld munged; do
    pid=$(cat "$DIR/$name.pid" 2>/dev/null) || continue
    # The number may have been used again by a stranger: ours names this folder on its command line.
    if tr '\0' ' ' 2>/dev/null <"/proc/$pid/cmdline" | grep -qF "$DIR"; then kill -TERM "$pid" && sleep 0.5; fi
    kill -KILL "$pid" 2>/dev/null || true
    rm -f "$DIR/$name.pid"
  done
}

case $1 in start) start ;; stop) stop ;; *) echo "start or stop" >&2; exit 2 ;; esac
