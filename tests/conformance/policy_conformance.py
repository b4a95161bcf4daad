"""What every policy must do: derive a test class from `PolicyConformance`, supply what is abstract in it.

Owns the meaning of `mdb_sim.teaching.policy.Policy` as tests. Uses the contract's members only, so that it fits any
policy: of a robot, of a machine of control, or one that wants nothing by itself.
"""

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mdb_sim.body import NOTHING, Numbers
from mdb_sim.teaching.languages import make_language
from mdb_sim.teaching.policy import OBEYED, Policy, likest
from tests.protocol.samples import fixed

inherited = settings(fixed, suppress_health_check=[HealthCheck.differing_executors])
"""Of tests that several classes have from one."""
EVENTS = (NOTHING, "capture", "bump", "end")


class PolicyConformance:
    """The suite."""

    def make(self) -> Policy:
        raise NotImplementedError

    def scenes(self) -> st.SearchStrategy[Numbers]:
        """Scenes, each with more in it than the policy needs."""
        raise NotImplementedError

    def actions(self) -> st.SearchStrategy[Numbers]:
        """Actions of such a body."""
        raise NotImplementedError

    def after(self, before: Numbers, action: Numbers) -> Numbers | None:
        """Return the scene after an action that does what it is meant to do; None: that is not known."""
        raise NotImplementedError

    def obeying(self, policy: Policy, command: int) -> Numbers | None:
        """Return an action that does what a command wants; None: none always does."""
        raise NotImplementedError

    def two(self, data: st.DataObject) -> tuple[Numbers, Numbers, str]:
        """Draw what happened: the scene before, any scene after it, and the event."""
        return data.draw(self.scenes()), data.draw(self.scenes()), data.draw(st.sampled_from(EVENTS))

    def test_there_are_commands_each_of_its_own_name_and_rank(self):
        policy = self.make()
        assert policy.commands
        assert all(isinstance(name, str) and name for name in policy.commands)
        assert len(set(policy.commands)) == len(policy.commands)
        assert sorted(policy.order) == list(range(len(policy.commands)))
        assert len(set(policy.needs)) == len(policy.needs)

    def test_each_kind_of_language_can_say_every_command(self):
        order = self.make().order
        for name in ("ordered", "reversed", "paper", "random:7"):
            language = make_language(name, order)
            assert [language.command(language.note(command)) for command in range(len(order))] == [*range(len(order))]

    @inherited
    @given(data=st.data())
    def test_what_is_wanted_is_a_command_or_nothing(self, data):
        wanted = self.make().want(data.draw(self.scenes()))
        assert wanted is None or (isinstance(wanted, int) and 0 <= wanted < len(self.make().commands))

    @inherited
    @given(data=st.data())
    def test_a_judgement_is_from_punishment_to_praise_or_cannot_be_told_whatever_was_wanted(self, data):
        policy, what = self.make(), self.two(data)
        judged = [policy.judge(*what, wanted) for wanted in range(len(policy.commands))]
        assert {value is None for value in judged} in ({True}, {False})
        assert all(-1.0 <= value <= 1.0 for value in judged if value is not None)

    @inherited
    @given(data=st.data())
    def test_what_happened_is_most_like_the_command_that_it_is_judged_best_for(self, data):
        policy, what = self.make(), self.two(data)
        judged = [policy.judge(*what, wanted) for wanted in range(len(policy.commands))]
        found = likest(policy, *what)
        if None in judged:
            assert found is None
            return
        assert judged[found] == max(judged)
        assert found == judged.index(max(judged)), "the first of equals"

    @inherited
    @given(data=st.data())
    def test_the_same_scenes_give_the_same_answers_and_are_left_as_they_were(self, data):
        policy, (before, after, event) = self.make(), self.two(data)
        action, wanted = data.draw(self.actions()), data.draw(st.integers(0, len(policy.commands) - 1))
        kept = dict(before), dict(after), dict(action)

        def answers(asked: Policy) -> tuple[object, ...]:
            judged = asked.judge(before, after, event, wanted)
            return asked.want(before), judged, asked.expected(wanted, action)

        first = answers(policy)
        policy.want(after)
        policy.judge(after, before, event, 0)
        assert answers(policy) == first, "it keeps nothing of what it was asked"
        assert answers(self.make()) == first, "so one that is started again teaches alike"
        assert (before, after, action) == kept

    @inherited
    @given(data=st.data())
    def test_it_looks_at_what_it_needs_and_at_nothing_else(self, data):
        policy, (before, after, event) = self.make(), self.two(data)
        assert set(policy.needs) <= before.keys()
        assert before.keys() - set(policy.needs), "scenes here are to have more"
        less = [{name: scene[name] for name in policy.needs} for scene in (before, after)]
        assert policy.want(less[0]) == policy.want(before)
        for wanted in range(len(policy.commands)):
            assert policy.judge(*less, event, wanted) == policy.judge(before, after, event, wanted)

    @inherited
    @given(data=st.data())
    def test_what_is_expected_is_what_the_action_is_judged_by_when_it_has_done_what_it_is_meant_to(self, data):
        policy, before, action = self.make(), data.draw(self.scenes()), data.draw(self.actions())
        after = self.after(before, action)
        for wanted in range(len(policy.commands)):
            expected = policy.expected(wanted, action)
            if expected is None:
                continue
            assert -1.0 <= expected <= 1.0
            judged = None if after is None else policy.judge(before, after, NOTHING, wanted)
            if judged is not None:
                assert abs(judged - expected) < 1e-3
                if abs(expected - OBEYED) > 1e-3:  # at the bound itself rounding decides
                    assert (judged >= OBEYED) == (expected >= OBEYED)

    def test_obedience_is_expected_of_those_actions_that_do_what_was_wanted_and_of_no_other(self):
        policy = self.make()
        commands = range(len(policy.commands))
        for done in commands:
            action = self.obeying(policy, done)
            for wanted in commands if action is not None else ():
                expected = policy.expected(wanted, action)
                assert expected is None or (expected >= OBEYED) == (wanted == done)

    @inherited
    @given(data=st.data())
    def test_who_does_what_is_wanted_has_obeyed_and_nobody_else(self, data):
        policy, before = self.make(), data.draw(self.scenes())
        wanted = policy.want(before)
        if wanted is None:
            return
        for done in range(len(policy.commands)):
            action = self.obeying(policy, done)
            after = None if action is None else self.after(before, action)
            judged = None if after is None else policy.judge(before, after, NOTHING, wanted)
            assert judged is None or (judged >= OBEYED) == (done == wanted)
            if judged is not None:
                assert likest(policy, before, after, NOTHING) == done

    @inherited
    @given(data=st.data())
    def test_of_an_action_of_another_body_nothing_is_expected(self, data):
        policy = self.make()
        wanted = data.draw(st.integers(0, len(policy.commands) - 1))
        assert policy.expected(wanted, {}) is None
        assert policy.expected(wanted, {"no_such_actuator": 1.0}) is None
