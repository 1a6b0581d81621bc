//! Which tool H and D mean, and what is known of it.

#![expect(clippy::panic, reason = "a test may fail")]

use evolvent_gcode::{Action, Code, Diagnostic, Interpreter, Move, Settings, ToolTable};

/// Tool 3 is a mill.
const TOOLS: &str = "T1 P1 D1.6 I95 J155 Q2\nT3 P3 Z50 D12\nT4 P4 Z20 D4";

fn run(program: &str) -> Result<Vec<Action>, Diagnostic> {
    let settings = Settings {
        tools: Some(ToolTable::parse(TOOLS).unwrap_or_else(|error| panic!("{error}"))),
        ..Settings::default()
    };
    Interpreter::new(program.as_bytes(), settings)
        .map(|item| item.map(|command| command.action))
        .collect()
}

fn moves(program: &str) -> Vec<Move> {
    let actions = run(program).unwrap_or_else(|error| panic!("{}\n{program}", error.render("x")));
    let moves = actions.into_iter().filter_map(|action| match action {
        Action::Move(step) => Some(step),
        _ => None,
    });
    moves.collect()
}

fn fault(program: &str) -> (Code, u32) {
    let error = run(program).err();
    let error = error.unwrap_or_else(|| panic!("nothing is wrong with\n{program}"));
    assert!(error.help.is_some(), "{}", error.render("x"));
    (error.code, error.line)
}

fn messages(program: &str) -> Vec<String> {
    let actions = run(program).unwrap_or_else(|error| panic!("{}\n{program}", error.render("x")));
    let texts = actions.into_iter().filter_map(|action| match action {
        Action::Message(text) => Some(text),
        _ => None,
    });
    texts.collect()
}

#[test]
fn tool_0_of_h_and_d_is_the_tool_in_the_spindle() {
    let length = |word: &str| moves(&format!("T3 M6\n{word}\nG0 Z10"))[0].curve.end()[2];
    assert_eq!(length("G43 H0"), 60.0);
    assert_eq!(length("G43.2 H0"), 60.0);
    assert_eq!(length("G43.2 H0\nG43.2 H4"), 80.0);
    assert_eq!(length("G43 H4"), 30.0);
    for word in ["G41 D0", "G41", "G41 D3"] {
        let found = moves(&format!("T3 M6 F100\nG0 X-20\n{word}\nG1 X0\nX20\nG40 X40"));
        assert_eq!(found[1].curve.end()[1], 6.0, "{word}");
        let found = moves("T3 M6 F100\nG0 X-20\nG42 D0\nG1 X0\nX20\nG40 X40");
        assert_eq!(found[1].curve.end()[1], -6.0);
    }
    // Without a tool there is none.
    assert_eq!(moves("G43 H0\nG0 Z10")[0].curve.end()[2], 10.0);
}

#[test]
fn g10_of_the_loaded_tool_counts_at_once() {
    let shown = "(DEBUG, #5400 #5403 #5410 #5411 #5412 #5413)\n";
    let text = messages(&format!(
        "T3 M6\n{shown}G10 L1 P3 Z7 R2 I11 J22 Q6\n{shown}G10 L1 P4 Z8 I33\n{shown}G10 L10 P3 Z0\n{shown}"
    ));
    let first = "3.000000 50.000000 12.000000 0.000000 0.000000 0.000000";
    let second = "3.000000 7.000000 4.000000 11.000000 22.000000 6.000000";
    let third = "3.000000 0.000000 4.000000 11.000000 22.000000 6.000000";
    let trimmed: Vec<_> = text.iter().map(|text| text.trim()).collect();
    assert_eq!(trimmed, [first, second, second, third]);
    assert_eq!(fault("T3 M6\nG10 L1 P0 Z1"), (Code::OutOfRange, 2));
}
