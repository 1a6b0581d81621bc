//! Messages in the form that the page sends and reads.

use evolvent_screen::messages::{
    CHUNK_HEADER_BYTES, FromPage, LogFact, PathChunk, PathKind, Refusal, SAMPLE_BYTES, SampleAnswer,
    ScreenStatus, ToPage, VERTEX_BYTES, put_sample,
};
use evolvent_wire::{Setpoint, Status};

#[test]
fn what_the_page_sends_is_understood() {
    let read = |text: &str| serde_json::from_str::<FromPage>(text);
    assert_eq!(read(r#"{"type":"keep"}"#).unwrap(), FromPage::Keep);
    assert_eq!(read(r#"{"type":"alive"}"#).unwrap(), FromPage::Alive);
    assert_eq!(
        read(r#"{"type":"take","force":true}"#).unwrap(),
        FromPage::Take { force: true }
    );
    assert_eq!(read(r#"{"type":"give"}"#).unwrap(), FromPage::Give);
    let jog = r#"{"type":"command","id":7,"seen_ns":4000000001,"steers":true,"command":20,"index":0,"amount":12.5,"axes_mask":2,"values":{"1":-1}}"#;
    let FromPage::Command(jog) = read(jog).unwrap() else {
        panic!("a command");
    };
    assert_eq!(
        (jog.id, jog.command, jog.axes_mask, jog.values["1"]),
        (7, 20, 2, -1.0)
    );
    assert_eq!((jog.seen_ns, jog.steers), (4_000_000_001, true));
    for wrong in [
        "",
        "{}",
        "[]",
        r#"{"type":"reboot"}"#,
        r#"{"type":"command","id":-1,"command":1}"#,
    ] {
        read(wrong).unwrap_err();
    }
}

#[test]
fn a_status_has_names_instead_of_numbers() {
    let status = Status {
        machine_state: 2,
        state: 7,
        tool_change: 1,
        ..Status::default()
    };
    let message = ToPage::Status {
        status: Box::new(ScreenStatus::from(&status)),
    };
    let json = serde_json::to_value(&message).unwrap();
    assert_eq!(json["type"], "status");
    let status = &json["status"];
    assert_eq!(
        (&status["machine_state"], &status["state"], &status["tool_change"]),
        (&"on".into(), &"program_stop".into(), &"operator".into())
    );
    assert_eq!(status["position_machine"].as_array().unwrap().len(), 9);
}

#[test]
fn the_log_says_by_code_and_fields_what_its_text_says() {
    let fact = LogFact::Rejected {
        command: "JOG".to_owned(),
        page: 3,
        reason: Refusal::TooLate.sentence().to_owned(),
        refusal: Some(Refusal::TooLate),
    };
    let text = "JOG by page 3 was rejected: the command arrived too late and was not sent";
    assert_eq!(fact.sentence(), text);
    let expected = serde_json::json!({
        "code": "rejected",
        "command": "JOG",
        "page": 3,
        "reason": "the command arrived too late and was not sent",
        "refusal": "too_late",
    });
    assert_eq!(serde_json::to_value(&fact).unwrap(), expected);
    let taken = LogFact::ControlTaken {
        page: 4,
        from: Some(3),
    };
    assert_eq!(taken.sentence(), "page 4 took control from page 3");
    let expected = serde_json::json!({"code": "control_taken", "page": 4, "from": 3});
    assert_eq!(serde_json::to_value(&taken).unwrap(), expected);
}

#[test]
fn binary_messages_have_their_layout() {
    let mut bytes = Vec::new();
    let mut setpoint = Setpoint {
        line: 12,
        due_time_ns: 2_500_000_000,
        flags: evolvent_wire::flags::RAPID,
        ..Setpoint::default()
    };
    setpoint.velocity[8] = 3.0;
    let mut errors = [f64::NAN; 9];
    errors[8] = 0.25;
    let mut velocity = [f64::NAN; 9];
    velocity[0] = 2.5;
    let answer = SampleAnswer {
        following_error: &errors,
        velocity: &velocity,
        position: &[1.5; 9],
        torque: &[0.75; 9],
        phase_error_us: -12.5,
        load: 1500.0,
        signals: &[800.0, 790.5, 270.0, 1.0],
    };
    put_sample(&mut bytes, &setpoint, &answer);
    assert_eq!(bytes.len(), SAMPLE_BYTES + 4 * 4);
    assert_eq!(bytes[0..8], 2.5_f64.to_le_bytes());
    assert_eq!(bytes[8..12], 12_u32.to_le_bytes());
    assert_eq!(bytes[12..16], evolvent_wire::flags::RAPID.to_le_bytes());
    let at = 24 + 4 * (9 + 8);
    assert_eq!(bytes[at..at + 4], 3.0_f32.to_le_bytes());
    let at = 24 + 4 * (27 + 8);
    assert_eq!(bytes[at..at + 4], 0.25_f32.to_le_bytes());
    assert_eq!(bytes[at + 4..at + 8], 1500.0_f32.to_le_bytes());
    assert_eq!(bytes[at + 8..at + 12], 2.5_f32.to_le_bytes());
    assert_eq!(bytes[at + 44..at + 48], 1.5_f32.to_le_bytes());
    assert_eq!(bytes[at + 80..at + 84], 0.75_f32.to_le_bytes());
    assert_eq!(bytes[at + 116..at + 120], (-12.5_f32).to_le_bytes());
    assert_eq!(bytes[SAMPLE_BYTES..SAMPLE_BYTES + 4], 800.0_f32.to_le_bytes());
    assert_eq!(bytes[SAMPLE_BYTES + 12..], 1.0_f32.to_le_bytes());

    let mut chunk = PathChunk::default();
    chunk.push([1.0, 2.0, 3.0], 50.0, 4, 0);
    chunk.push([5.0, 6.0, 7.0], -90.0, 8, 7);
    let bytes = chunk.take_bytes(PathKind::Planned, 9);
    assert!(chunk.is_empty());
    assert_eq!(bytes.len(), CHUNK_HEADER_BYTES + 2 * VERTEX_BYTES);
    assert_eq!(bytes[0..4], 2_u32.to_le_bytes());
    assert_eq!(bytes[4..8], 1_u32.to_le_bytes(), "planned");
    assert_eq!(bytes[8..12], 9_u32.to_le_bytes(), "replaced");
    assert_eq!(bytes[24..28], 5.0_f32.to_le_bytes(), "second vertex");
    assert_eq!(bytes[40..44], (-90.0_f32).to_le_bytes(), "second feed");
    assert_eq!(bytes[48..52], 8_u32.to_le_bytes(), "second line");
    assert_eq!(bytes[52..], [0, 7], "what limits");
}
