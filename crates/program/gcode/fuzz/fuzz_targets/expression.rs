//! Formulas: a finite value or an error, the same in any case and with any blanks, and once more in brackets.
#![no_main]

use evolvent_gcode::{Code, Interpreter, Settings};
use libfuzzer_sys::fuzz_target;

fn value(formula: &[u8]) -> Result<f64, Code> {
    let mut program = b"#1=2 #2=-0.5 #<a>=3\n#31=[".to_vec();
    program.extend_from_slice(formula);
    program.extend_from_slice(b"]\n");
    let mut interpreter = Interpreter::new(&program[..], Settings::default());
    for item in &mut interpreter {
        if let Err(error) = item {
            return Err(error.code);
        }
    }
    Ok(interpreter.parameter(31))
}

fuzz_target!(|data: &[u8]| {
    let known = |byte: &u8| byte.is_ascii_alphanumeric() || b" \t.+-*/[]#<>_".contains(byte);
    if data.len() > 300 || !data.iter().all(known) {
        return;
    }
    let plain = value(data);
    if let Ok(value) = plain {
        assert!(value.is_finite());
    }
    // Brackets that close others change the meaning.
    let mut depth = 0_i32;
    let balanced = data.iter().all(|byte| {
        depth += i32::from(*byte == b'[') - i32::from(*byte == b']');
        depth >= 0
    });
    if !balanced || depth != 0 || data.len() > 100 {
        return;
    }
    let mut again = vec![b'['];
    for byte in data {
        again.push(if byte.is_ascii_lowercase() { byte.to_ascii_uppercase() } else { byte.to_ascii_lowercase() });
    }
    again.push(b']');
    match (plain, value(&again)) {
        (Ok(first), Ok(second)) => assert_eq!(first.to_bits(), second.to_bits()),
        (Err(_), Err(_)) | (_, Err(Code::NestingTooDeep)) => {}
        other => panic!("{other:?} for {:?}", String::from_utf8_lossy(data)),
    }
});
