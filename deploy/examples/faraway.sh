#!/usr/bin/env bash
# A teacher in another network: a namespace of its own, QUIC, keys, and every twentieth packet lost each way.
# Needs root, ip (iproute2) and nft (nftables). Usage: faraway.sh LESSONS [further words for `mdb up`]
set -euo pipefail
lessons=$1
shift
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
far=mdb-far-$$ near=mdb$$ net=10.$((77 + $$ % 100)).$(($$ / 100 % 250))

clean() {
  [ -z "${brain:-}" ] || { kill "$brain" 2>/dev/null && wait "$brain" || true; }
  ip link delete "$near" 2>/dev/null || true
  ip netns delete "$far" 2>/dev/null || true
  nft delete table inet "$near" 2>/dev/null || true
}
trap clean EXIT

lossy() { # every twentieth packet that comes in by this link is dropped
  "$@" nft "add table inet $near; add chain inet $near in { type filter hook input priority 0; };
    add rule inet $near in iifname \"$link\" numgen random mod 100 < 5 counter drop"
}

ip netns add "$far"
ip link add "$near" type veth peer name "$near-far" netns "$far"
ip address add "$net.1/24" dev "$near" && ip link set "$near" up
ip -n "$far" address add "$net.2/24" dev "$near-far" && ip -n "$far" link set "$near-far" up
ip -n "$far" link set lo up
link=$near lossy
link=$near-far lossy ip netns exec "$far"

cd "$work"
mdb keys init --host "$net.1" >/dev/null
mdb keys add-teacher ann >/dev/null
mdb up paper --no-teacher --runs runs --keys keys --listen "quic/$net.1:7447" --no-plot "$@" >up.log 2>&1 &
brain=$!
for _ in $(seq 600); do
  grep -q "begins when somebody teaches" up.log && [ -s runs/*/router.endpoint ] 2>/dev/null && break
  kill -0 "$brain" || { cat up.log; exit 1; }
  sleep 0.1
done
ip netns exec "$far" "$(command -v python)" "$here/teacher.py" "quic/$net.1:7447" "$lessons" keys/teachers/ann.pem
echo "lost on the way: $(ip netns exec "$far" nft list table inet "$near" | grep -o 'packets [0-9]*') to the teacher," \
  "$(nft list table inet "$near" | grep -o 'packets [0-9]*') from there"
echo "run: $work/$(echo runs/*)"
