"""What breeding does to the units and the weights of a child, a row of vector lanes at once.

Written as LLVM instructions: Python's loops would not become vectors here, since the compiler cannot know that a
child's weights are not its parents'. Arrays are taken whole, with a flat index. Populations are read and written
under a mask, never beyond what counts; the spaces to work in have room for `ROW` more.
"""

# ruff: noqa: ARG001, PLR0917 - the compiler's argument has no use here; compiled functions take arrays by position
# mypy: allow-untyped-calls

from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types

from mdb_services.mechanism.evolution.compiled.compiling import compiled, emitted, inlined
from mdb_services.mechanism.evolution.compiled.vectors import (
    BITS,
    BYTES,
    FLOATS,
    INDICES,
    Array,
    every,
    first_lanes,
    spread,
)
from mdb_services.mechanism.evolution.layout import ROW

GOLDEN, MIX = 0x9E3779B97F4A7C15, ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB))
"""Of splitmix64."""
SUM_MEAN, SUM_SCALE = 2 * 65535, (3.0 / (2.0**32 - 1.0)) ** 0.5
"""The sum of four 16-bit integers has this mean; one over its standard deviation."""
UNITS, WEIGHTS = 16, 2**32
"""Indices of a child's numbers from which on units and weights have one each."""

_word: Any = np.uint64
_0, _1, _ROW, _WEIGHTS, _SUM_SCALE = _word(0), _word(1), _word(ROW), _word(WEIGHTS), np.float32(SUM_SCALE)

_FUSED = ("contract",)
_WORDS = ir.VectorType(ir.IntType(64), ROW)


# ---- LLVM instructions: these functions run when their callers are compiled, and emit them ----


def _draw(builder: Any, start: Any, index: Any) -> Any:
    """Return the 64 random bits of each lane: numbers of a stream, from an index on."""
    first = builder.add(start, builder.mul(index, index.type(GOLDEN)))
    steps = ir.Constant(_WORDS, [GOLDEN * (lane + 1) % 2**64 for lane in range(ROW)])
    z = builder.add(spread(builder, first), steps)
    for shift, factor in MIX:
        z = builder.mul(builder.xor(z, builder.lshr(z, every(_WORDS, shift))), every(_WORDS, factor))
    return builder.xor(z, builder.lshr(z, every(_WORDS, 31)))


def _sum_of_four(builder: Any, bits: Any) -> Any:
    """Return sums of four uniform integers, less their mean: nearly normal, never beyond 3.47 deviations."""
    halves = every(_WORDS, 0x0000FFFF0000FFFF)
    two = builder.add(builder.and_(bits, halves), builder.and_(builder.lshr(bits, every(_WORDS, 16)), halves))
    low, high = builder.trunc(two, INDICES), builder.trunc(builder.lshr(two, every(_WORDS, 32)), INDICES)
    return builder.sitofp(builder.sub(builder.add(low, high), every(INDICES, SUM_MEAN)), FLOATS)


class _Mixing:
    """Some weights of a child that follow one another, mixed from its parents'."""

    def __init__(self, context: Any, builder: Any, kinds: Any, arguments: Any) -> None:
        weights, first, second, shares, senders, carried, own, self.children, self.place, count = arguments
        weights, shares = (Array(context, builder, kinds[i], array) for i, array in ((0, weights), (3, shares)))
        self.children = Array(context, builder, kinds[7], self.children)
        self.counts, none = first_lanes(builder, count), every(FLOATS, 0.0)
        mine, its = (weights.load(index, FLOATS, self.counts, none) for index in (first, second))
        share = builder.select(first_lanes(builder, carried), shares.load(senders, FLOATS), spread(builder, own))
        between = builder.fmul(share, builder.fsub(mine, its), flags=_FUSED)
        between = builder.fadd(its, between, flags=_FUSED)
        one = builder.fcmp_ordered("==", share, every(FLOATS, 1.0))
        self.mixed = builder.select(one, mine, between)


# ---- what compiled Python calls of it ----


@emitted
def _cross_row(
    typingctx: Any,
    promoters: Any,
    first: Any,
    second: Any,
    hidden: Any,
    start: Any,
    unit: Any,
    threshold: Any,
    genes: Any,
    shares: Any,
    chosen: Any,
) -> Any:
    """Draw a row of units; see `cross_units`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, (promoters, first, second, hidden, start, unit, threshold, *spaces) = signature.args, arguments
        promoters = Array(context, builder, kinds[0], promoters)
        genes, shares, chosen = (
            Array(context, builder, kind, space) for kind, space in zip(kinds[7:10], spaces, strict=True)
        )
        bits = _draw(builder, start, builder.add(unit, unit.type(UNITS)))
        promoted, expressed = first_lanes(builder, hidden), every(BYTES, 1)
        one, other = (promoters.load(index, BYTES, promoted, expressed) for index in (first, second))
        alike = builder.icmp_unsigned("==", one, other)
        coin = builder.and_(builder.trunc(builder.lshr(bits, every(_WORDS, 32)), BYTES), expressed)
        part = builder.sitofp(builder.trunc(builder.lshr(bits, every(_WORDS, 40)), INDICES), FLOATS)
        part = builder.fmul(part, every(FLOATS, 2.0**-24))
        whole = builder.uitofp(builder.select(alike, coin, one), FLOATS)
        both = builder.and_(alike, builder.trunc(one, BITS))
        low = builder.and_(bits, every(_WORDS, 2**32 - 1))
        mutated = builder.icmp_unsigned("<", low, spread(builder, threshold))
        genes.store(builder.select(alike, one, coin), unit)
        shares.store(builder.select(both, part, whole), unit)
        chosen.store(builder.zext(mutated, BYTES), unit)
        return context.get_dummy_value()

    word = types.uint64
    spaces = (genes, shares, chosen)
    return types.void(promoters, word, word, word, word, word, word, *spaces), generate


@emitted
def _mix_row(
    typingctx: Any,
    weights: Any,
    first: Any,
    second: Any,
    shares: Any,
    senders: Any,
    carried: Any,
    own: Any,
    children: Any,
    place: Any,
    count: Any,
) -> Any:
    """Write a row of a child's weights, mixed: the first few by the senders' shares, the others by the unit's own."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        row = _Mixing(context, builder, signature.args, arguments)
        row.children.store(row.mixed, row.place, row.counts)
        return context.get_dummy_value()

    word = types.uint64
    return types.void(weights, word, word, shares, word, word, types.float32, children, word, word), generate


@emitted
def _change_row(
    typingctx: Any,
    weights: Any,
    first: Any,
    second: Any,
    shares: Any,
    senders: Any,
    carried: Any,
    own: Any,
    children: Any,
    place: Any,
    count: Any,
    genes: Any,
    before: Any,
    start: Any,
    index: Any,
    scale: Any,
    limit: Any,
) -> Any:
    """The same, and add random numbers, within the limit, to the bias and the weights from expressed units."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, senders = signature.args, arguments[4]
        genes, before, start, index, scale, limit = arguments[10:]
        row = _Mixing(context, builder, kinds, arguments[:10])
        number = _sum_of_four(builder, _draw(builder, start, index))
        new = builder.fadd(row.mixed, builder.fmul(number, spread(builder, scale), flags=_FUSED), flags=_FUSED)
        most, least = spread(builder, limit), spread(builder, builder.fneg(limit))
        new = builder.select(builder.fcmp_ordered("<", most, new), most, new)
        new = builder.select(builder.fcmp_ordered(">", least, new), least, new)
        silent = builder.icmp_unsigned(
            "==", Array(context, builder, kinds[10], genes).load(senders, BYTES), every(BYTES, 0)
        )
        silent = builder.and_(silent, first_lanes(builder, before))
        row.children.store(builder.select(silent, row.mixed, new), row.place, row.counts)
        return context.get_dummy_value()

    word, number = types.uint64, types.float32
    mixing = (weights, word, word, shares, word, word, number, children, word, word)
    return types.void(*mixing, genes, word, word, word, number, number), generate


# ---- compiled Python ----


@compiled
def cross_units(
    promoters: Any,
    first: int,
    second: int,
    start: Any,
    threshold: Any,
    units: int,
    genes: Any,
    shares: Any,
    chosen: Any,
) -> None:
    """Write for each unit of a child whether it is expressed, the first parent's share of it, and the chosen ones.

    Both parents, rows of promoters, express it: the weights mix. Neither: one parent's unit as it is. One does: its
    weights, and the promoter of either with equal probability, so the expected number of expressed units is the
    parents' mean. Outputs are units that all express. Units are chosen with the probability threshold / 2**32.
    genes and chosen uint8, shares float32: hidden units, outputs, and room for `ROW` more.
    """
    hidden = _word(promoters.shape[1])
    mine, its = _word(first) * hidden, _word(second) * hidden
    for unit in range(_0, _word(units), _ROW):
        left = hidden - min(unit, hidden)
        _cross_row(promoters, mine + unit, its + unit, left, start, unit, threshold, genes, shares, chosen)


@inlined
def write_weights(
    weights: Any,
    first: int,
    second: int,
    sizes: Any,
    genes: Any,
    shares: Any,
    chosen: Any,
    start: Any,
    step: Any,
    limit: Any,
    children: Any,
    child: int,
    places: Any,
) -> None:
    """Write a child's weights: its parents', mixed by the shares, and changed where a unit is chosen and expressed.

    An output's weights, but for the bias, have the shares of the units that they come from. A change is a normal
    number times the step, within the limit, and none for weights from units that are not expressed: what does not
    count stays as it is, the memory of old tasks. genes, shares: as `cross_units` writes them, followed by the inputs
    and room for `ROW` more; an input's gene is 1. places (units of the largest layer,) uint64: space to work in.
    """
    wide, base, unit = _word(weights.shape[1]), _0, _0
    mine, its, its_own = _word(first) * wide, _word(second) * wide, _word(child) * wide
    senders, scale = _word(genes.size - sizes[0]) - _ROW, np.float32(step) * _SUM_SCALE
    for layer in range(1, sizes.size):
        before, end, count = _word(sizes[layer - 1]), unit + _word(sizes[layer]), _0
        carried, length = before if layer == sizes.size - 1 else _0, before + _1
        for u in range(unit, end):
            places[count] = u  # no branch: nobody could foretell it
            count += _word(chosen[u] & genes[u])
        for part in range(_0, length, _ROW):
            sender, left, rest, at = senders + part, carried - min(part, carried), length - part, base + part
            for u in range(unit, end):
                _mix_row(weights, mine + at, its + at, shares, sender, left, shares[u], children, its_own + at, rest)
                at += length
            for k in range(count):
                u = places[k]
                at = base + (u - unit) * length + part
                _change_row(
                    weights,
                    mine + at,
                    its + at,
                    shares,
                    sender,
                    left,
                    shares[u],
                    children,
                    its_own + at,
                    rest,
                    genes,
                    before - part,
                    start,
                    _WEIGHTS + at,
                    scale,
                    limit,
                )
        base += (end - unit) * length
        senders, unit = unit, end
