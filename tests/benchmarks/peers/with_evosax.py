"""evosax on JAX: ask, evaluate and tell compiled together, in one loop over the generations.

The library's own `ask`, `tell` and `init`; only the error function is ours.
"""

import jax
import jax.numpy as jnp
import numpy as np
import optax
from evosax.algorithms import SNES, SimpleGA
from numpy.typing import NDArray

from tests.benchmarks.peers.contestant import Contestant
from tests.benchmarks.peers.problem import Floats, Problem, first_population

STEP, STEP_DECAY, STEP_END, ELITE, SNES_STEP = 0.1, 0.995, 0.01, 0.05, 0.3
"""The best of a small grid on the recorded memories."""


class Documented(Contestant):
    """One network as one writes it, `vmap` over the population."""

    def __init__(self, problem: Problem, population: int) -> None:
        super().__init__(problem, population)
        self.inputs, self.targets = jnp.asarray(problem.inputs), jnp.asarray(problem.targets)
        self.strategy = self.make()
        self.params = self.parameters()
        self._errors = jax.jit(self.population_errors)
        self._generations = jax.jit(self.generations)

    def make(self):
        schedule = optax.exponential_decay(STEP, transition_steps=1, decay_rate=STEP_DECAY, end_value=STEP_END)
        strategy = SimpleGA(self.population, jnp.zeros(self.problem.weights), std_schedule=schedule)
        strategy.elite_ratio = ELITE
        return strategy

    def parameters(self):
        return self.strategy.default_params

    def matrices(self, genome):
        (hidden, before), (outputs, after) = self.problem.layers
        return genome[: hidden * before].reshape(hidden, before), genome[hidden * before :].reshape(outputs, after)

    def error(self, genome):
        first, last = self.matrices(genome)
        rows = jnp.tanh(self.inputs @ first[:, :-1].T + first[:, -1])
        outputs = rows @ last[:, :-1].T + last[:, -1]
        return jnp.mean((outputs - self.targets) ** 2)

    def population_errors(self, genomes):
        return jax.vmap(self.error)(genomes)

    def generations(self, key, state, count):
        def step(_, carry):
            key, state = carry
            key, asking, telling = jax.random.split(key, 3)
            genomes, state = self.strategy.ask(asking, state, self.params)
            state, _ = self.strategy.tell(telling, genomes, self.population_errors(genomes), state, self.params)
            return key, state

        return jax.lax.fori_loop(0, count, step, (key, state))

    def first_state(self, key, genomes):
        return self.strategy.init(key, genomes, self._errors(genomes), self.params)

    def reset(self, seed: int) -> None:
        self.key, key = jax.random.split(jax.random.key(seed))
        genomes = jnp.asarray(first_population(self.problem, self.population, seed))
        self.state = self.first_state(key, genomes)

    def run(self, generations: int) -> None:
        self.key, self.state = jax.block_until_ready(self._generations(self.key, self.state, generations))

    def best(self) -> float:
        return float(self.state.best_fitness)

    def errors(self, genomes: Floats) -> NDArray:
        return np.asarray(self._errors(genomes))


class Fastest(Documented):
    """Pairs along the rows, where XLA makes the better loops, and 50 genomes at a time, which stay in the cache."""

    def error(self, genome):
        first, last = self.matrices(genome)
        columns = jnp.tanh(first[:, :-1] @ self.inputs.T + first[:, -1:])
        outputs = last[:, :-1] @ columns + last[:, -1:]
        return jnp.mean((outputs - self.targets.T) ** 2)

    def population_errors(self, genomes):
        return jax.lax.map(self.error, genomes, batch_size=50)


class Snes(Fastest):
    """A natural evolution strategy with a step of its own for each weight."""

    def make(self):
        return SNES(self.population, jnp.zeros(self.problem.weights))

    def parameters(self):
        return self.strategy.default_params.replace(std_init=SNES_STEP)

    def first_state(self, key, genomes):
        return self.strategy.init(key, genomes[0], self.params)
