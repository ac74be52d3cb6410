# SPDX-License-Identifier: GPL-3.0-or-later
"""Long work of operators: Esc ends it at once and cleanly, errors are told, and without a window it blocks."""
from types import SimpleNamespace

import pytest


@pytest.fixture
def stepwise(module, monkeypatch):
    stepwise = module("operators.stepwise")
    monkeypatch.setattr(stepwise, "BUDGET", 0.0)  # a step at a time
    return stepwise


@pytest.fixture
def context():
    """What an operator uses of a window; `told` collects what happened."""
    told = []
    manager = SimpleNamespace(
        progress_begin=lambda low, high: told.append("begin"), progress_update=told.append, progress_end=lambda: told.append("end"),
        event_timer_add=lambda seconds, window: "timer", event_timer_remove=lambda timer: told.append(f"no {timer}"),
        modal_handler_add=lambda operator: told.append("modal"))
    return SimpleNamespace(window_manager=manager, window=None, workspace=SimpleNamespace(status_text_set=told.append), told=told)


@pytest.fixture
def operator(stepwise):
    class Operator(stepwise.Stepwise):
        doing = "Counting"
        closed, reports = False, ()

        def report(self, kind, text):
            self.reports += ((*kind, text),)

        def finish(self, context, result):
            self.result = result

        def steps(self, error=None):
            try:
                yield 1, 2
                if error:
                    raise error
                yield 2, 2, "Counting"
                return "counted"
            finally:
                self.closed = True

    return Operator()


def event(kind, ctrl=False):
    return SimpleNamespace(type=kind, ctrl=ctrl, alt=False)


def test_a_script_waits(operator, context):
    assert operator.begin(context, operator.steps()) == {'FINISHED'} and operator.result == "counted"
    assert context.told == ["begin", 50, 100, "end"]


def test_in_a_window_it_goes_on_with_the_timer_once(operator, context, stepwise, monkeypatch):
    monkeypatch.setattr(stepwise, "bpy", SimpleNamespace(app=SimpleNamespace(background=False)))
    operator._interactive = True
    assert operator.begin(context, operator.steps()) == {'RUNNING_MODAL'} and not operator._interactive
    assert operator.modal(context, event('X')) == {'RUNNING_MODAL'}
    assert operator.modal(context, event('TIMER')) == {'PASS_THROUGH'}, "panels that move have timers of their own"
    assert operator.modal(context, event('TIMER')) == {'FINISHED'} and operator.closed
    assert any("Counting: 2 of 2 " in str(text) for text in context.told)
    assert context.told[-3:] == ["end", None, "no timer"]


def test_meanwhile_the_view_can_be_turned_and_a_free_work_leaves_the_rest_alone_too(operator, context, stepwise, monkeypatch):
    monkeypatch.setattr(stepwise, "bpy", SimpleNamespace(app=SimpleNamespace(background=False)))
    operator._interactive = True
    operator.begin(context, operator.steps())
    for kind, ctrl, passes in (('MIDDLEMOUSE', False, True), ('WHEELUPMOUSE', False, True), ('WHEELUPMOUSE', True, False),
                               ('NUMPAD_7', False, True), ('LEFTMOUSE', False, False), ('DEL', False, False)):
        assert (operator.modal(context, event(kind, ctrl)) == {'PASS_THROUGH'}) == passes, kind
    operator.free = True
    assert operator.modal(context, event('LEFTMOUSE')) == {'PASS_THROUGH'}
    assert operator.modal(context, event('ESC')) == {'CANCELLED'}


def test_escape_ends_it(operator, context, stepwise, monkeypatch):
    monkeypatch.setattr(stepwise, "bpy", SimpleNamespace(app=SimpleNamespace(background=False)))
    operator._interactive = True
    operator.begin(context, operator.steps())
    assert operator.modal(context, event('ESC')) == {'CANCELLED'} and operator.closed
    assert "interrupted" in operator.reports[0][1] and context.told[-3:] == ["end", None, "no timer"]


def test_errors_are_told_and_faults_pass(operator, context, fg):
    assert operator.begin(context, operator.steps(fg.FastGSError("there is no room."))) == {'CANCELLED'} and operator.closed
    assert operator.reports == (('ERROR', "There is no room."),) and context.told[-1] == "end"
    with pytest.raises(ZeroDivisionError):
        operator.begin(context, operator.steps(ZeroDivisionError()))
    assert context.told[-1] == "end"


def test_an_error_at_the_end_is_told(operator, context, fg):
    def finish(context, result):
        raise fg.FastGSError("the disk is full.")

    operator.finish = finish
    assert operator.begin(context, operator.steps()) == {'CANCELLED'} and operator.reports == (('ERROR', "The disk is full."),)


def test_without_a_window_the_terminal_shows_it(operator, context, stepwise, monkeypatch, capsys):
    monkeypatch.setattr(stepwise, "REPORT_EVERY", -1.0)
    operator.begin(context, operator.steps())
    operator.begin(context, (step for step in [(0.25, 1)]))
    assert capsys.readouterr().out.splitlines() == [f"FAST-GS: Counting: {text}" for text in ("1 of 2", "2 of 2", "25%")]
