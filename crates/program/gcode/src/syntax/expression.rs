//! Expressions, evaluated while they are read.
//!
//! RS274/NGC, 3.3.2.2 and 3.3.2.3, with LinuxCNC's comparisons. Precedence: `**`, then `*` `/` `MOD`, then
//! `+` `-`, then `EQ` `NE` `GT` `GE` `LT` `LE`, then `AND` `OR` `XOR`; operators of equal precedence, `**`
//! included, are evaluated from left to right. Angles are in degrees. EQ and NE compare within 1e-6.

use crate::Code;
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::parameters::names::NormalizedName;
use crate::parameters::values::NUMBERED;
use crate::state::scope::Scope;
use crate::syntax::lexer::Lexer;
use evolvent_config::plain;

/// Maximum nesting depth of brackets, functions and parameters of parameters.
const MAX_DEPTH: u32 = 64;

/// Numbers closer than this are equal for EQ and NE; LE and GE compare exactly, as in LinuxCNC.
const EQUAL_TOLERANCE: f64 = 1e-6;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Operator {
    And,
    Or,
    Xor,
    Equal,
    NotEqual,
    Greater,
    GreaterEqual,
    Less,
    LessEqual,
    Add,
    Subtract,
    Multiply,
    Divide,
    Modulo,
    Power,
}

impl Operator {
    /// Its precedence.
    fn precedence(self) -> u32 {
        match self {
            Self::And | Self::Or | Self::Xor => 1,
            Self::Equal
            | Self::NotEqual
            | Self::Greater
            | Self::GreaterEqual
            | Self::Less
            | Self::LessEqual => 2,
            Self::Add | Self::Subtract => 3,
            Self::Multiply | Self::Divide | Self::Modulo => 4,
            Self::Power => 5,
        }
    }
}

/// The target of an assignment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Target {
    /// `#5`
    Numbered(usize),
    /// `#<name>`: the span of the name on the line.
    Named(Span),
}

/// Reads values from a line.
pub(crate) struct Evaluator<'line, 'text> {
    pub(crate) lexer: &'line mut Lexer<'text>,
    pub(crate) scope: &'line Scope<'line>,
    depth: u32,
}

impl<'line, 'text> Evaluator<'line, 'text> {
    pub(crate) fn new(lexer: &'line mut Lexer<'text>, scope: &'line Scope<'line>) -> Self {
        Self {
            lexer,
            scope,
            depth: 0,
        }
    }

    /// A number, parameter, function or bracketed expression, with any signs before it. `None` if none of
    /// these comes next.
    #[inline]
    pub(crate) fn value(&mut self) -> Result<Option<f64>, Fault> {
        match self.lexer.peek() {
            Some(b'0'..=b'9' | b'.') => self.lexer.number().map(Some),
            Some(sign @ (b'+' | b'-')) => match self.lexer.peek_second() {
                Some(b'#' | b'[' | b'+' | b'-' | b'a'..=b'z' | b'A'..=b'Z') => {
                    let start = self.lexer.position();
                    self.lexer.advance();
                    self.nest(start)?;
                    let value = self.value()?;
                    self.depth -= 1;
                    let Some(value) = value else {
                        let message = "a sign without a number";
                        return Err(Fault::new(Code::BadNumber, Span::at(start), message));
                    };
                    Ok(Some(if sign == b'-' { -value } else { value }))
                }
                _ => self.lexer.number().map(Some),
            },
            Some(b'[') => self.bracket().map(Some),
            Some(b'#') => self.parameter().map(Some),
            Some(b'a'..=b'z' | b'A'..=b'Z') => self.function(),
            _ => Ok(None),
        }
    }

    /// The same, but required. `what` is the use of the value, for the error message.
    pub(crate) fn required(&mut self, what: &str) -> Result<f64, Fault> {
        let start = self.lexer.position();
        match self.value()? {
            Some(value) => Ok(value),
            None => Err(self.missing(start, what)),
        }
    }

    #[cold]
    fn missing(&mut self, start: usize, what: &str) -> Fault {
        match self.lexer.peek() {
            Some(byte) if !byte.is_ascii_alphabetic() && !matches!(byte, b'(' | b';' | b']') => {
                self.lexer.unexpected(byte)
            }
            _ => Fault::new(
                Code::Expression,
                Span::at(start),
                format!("a value is missing {what}"),
            )
            .help("write a number, a parameter (#5, #<name>), a function (SIN[30]) or a formula in [ ]"),
        }
    }

    /// A bracketed expression; the next character is `[`.
    pub(crate) fn bracket(&mut self) -> Result<f64, Fault> {
        let start = self.lexer.position();
        self.lexer.advance();
        self.nest(start)?;
        let value = self.binary(1)?;
        self.depth -= 1;
        if self.lexer.take(b']') {
            return Ok(value);
        }
        Err(self.unclosed(start))
    }

    #[cold]
    fn unclosed(&mut self, start: usize) -> Fault {
        let position = self.lexer.position();
        match self.lexer.peek() {
            None | Some(b';' | b'(') => {
                Fault::new(Code::Expression, Span::at(start), "this '[' is not closed").help(
                    "write ] at the end of the expression; comments are not permitted inside expressions",
                )
            }
            Some(_) => Fault::new(
                Code::Expression,
                Span::at(position),
                "an operator or ] is missing here",
            )
            .help("operators are + - * / ** MOD, EQ NE GT GE LT LE, AND OR XOR"),
        }
    }

    /// Operators of at least a precedence, from left to right.
    fn binary(&mut self, min_precedence: u32) -> Result<f64, Fault> {
        let mut left = self.required("in this expression")?;
        loop {
            let start = self.lexer.position();
            let Some(operator) = self.operator()? else {
                return Ok(left);
            };
            if operator.precedence() < min_precedence {
                self.lexer.seek(start);
                return Ok(left);
            }
            let span = Span::new(start, self.lexer.position());
            let right = self.binary(operator.precedence() + 1)?;
            left = apply(operator, left, right, span)?;
        }
    }

    fn operator(&mut self) -> Result<Option<Operator>, Fault> {
        let Some(byte) = self.lexer.peek() else {
            return Ok(None);
        };
        let start = self.lexer.position();
        let operator = match byte {
            b'+' => Operator::Add,
            b'-' => Operator::Subtract,
            b'/' => Operator::Divide,
            b'*' => {
                self.lexer.advance();
                return Ok(Some(if self.lexer.take(b'*') {
                    Operator::Power
                } else {
                    Operator::Multiply
                }));
            }
            b'a'..=b'z' | b'A'..=b'Z' => {
                for (word, operator) in [
                    (&b"and"[..], Operator::And),
                    (b"or", Operator::Or),
                    (b"xor", Operator::Xor),
                    (b"eq", Operator::Equal),
                    (b"ne", Operator::NotEqual),
                    (b"gt", Operator::Greater),
                    (b"ge", Operator::GreaterEqual),
                    (b"lt", Operator::Less),
                    (b"le", Operator::LessEqual),
                    (b"mod", Operator::Modulo),
                ] {
                    if self.lexer.keyword(word) {
                        return Ok(Some(operator));
                    }
                }
                let message = "no such operator";
                return Err(Fault::new(Code::Expression, Span::at(start), message)
                    .help("operators are + - * / ** MOD, EQ NE GT GE LT LE, AND OR XOR"));
            }
            _ => return Ok(None),
        };
        self.lexer.advance();
        Ok(Some(operator))
    }

    /// A function of a bracketed value. `None` if no letters followed by `[` come next.
    fn function(&mut self) -> Result<Option<f64>, Fault> {
        let start = self.lexer.position();
        let mut word = [0; 16];
        let length = self.lexer.take_letters(&mut word);
        if self.lexer.peek() != Some(b'[') {
            self.lexer.seek(start);
            return Ok(None);
        }
        let span = Span::new(start, self.lexer.position());
        let name = &word[..length];
        if name == b"exists" {
            return self.exists().map(Some);
        }
        self.nest(start)?;
        let x = self.bracket()?;
        self.depth -= 1;
        let domain_error = |message: String| Err(Fault::new(Code::Arithmetic, span, message));
        let value = match name {
            b"atan" => {
                if !self.lexer.take(b'/') {
                    let message = "ATAN needs two values";
                    return Err(Fault::new(Code::Expression, span, message).help("write ATAN[y]/[x]"));
                }
                if self.lexer.peek() != Some(b'[') {
                    let message = "the second value of ATAN must be in brackets";
                    return Err(Fault::new(Code::Expression, span, message).help("write ATAN[y]/[x]"));
                }
                self.nest(start)?;
                let second = self.bracket()?;
                self.depth -= 1;
                libm::atan2(x, second).to_degrees()
            }
            b"abs" => x.abs(),
            b"acos" if !(-1.0..=1.0).contains(&x) => {
                return domain_error(format!("ACOS[{x}]: beyond -1 to 1"));
            }
            b"asin" if !(-1.0..=1.0).contains(&x) => {
                return domain_error(format!("ASIN[{x}]: beyond -1 to 1"));
            }
            b"acos" => libm::acos(x).to_degrees(),
            b"asin" => libm::asin(x).to_degrees(),
            b"cos" => libm::cos(x.to_radians()),
            b"exp" => libm::exp(x),
            b"fix" => x.floor(),
            b"fup" => x.ceil(),
            b"round" => x.round(),
            b"ln" if x <= 0.0 => return domain_error(format!("LN[{x}]: only of numbers above 0")),
            b"ln" => libm::log(x),
            b"sin" => libm::sin(x.to_radians()),
            b"sqrt" if x < 0.0 => return domain_error(format!("SQRT[{x}]: not of negative numbers")),
            b"sqrt" => x.sqrt(),
            b"tan" => libm::tan(x.to_radians()),
            _ => {
                let upper = String::from_utf8_lossy(name).to_ascii_uppercase();
                let message = format!("there is no function {upper}");
                return Err(Fault::new(Code::Expression, span, message).help(
                    "functions are ABS ACOS ASIN ATAN[]/[] COS EXISTS EXP FIX FUP LN ROUND SIN SQRT TAN",
                ));
            }
        };
        finite(value, span).map(Some)
    }

    /// `EXISTS[#<name>]`; the next character is `[`.
    fn exists(&mut self) -> Result<f64, Fault> {
        let start = self.lexer.position();
        self.lexer.advance();
        let expected_name = |position: usize| {
            Fault::new(
                Code::Expression,
                Span::at(position),
                "EXISTS requires a named parameter",
            )
            .help("write EXISTS[#<name>]")
        };
        if self.lexer.peek() != Some(b'#') {
            return Err(expected_name(start));
        }
        if self.lexer.peek_second() != Some(b'<') {
            // Whether a numbered parameter exists depends on its number alone.
            self.lexer.advance();
            self.nest(start)?;
            let index = self.required("after #")?.round();
            self.depth -= 1;
            if !self.lexer.take(b']') {
                return Err(expected_name(self.lexer.position()));
            }
            return Ok(f64::from(u8::from((1.0..NUMBERED as f64).contains(&index))));
        }
        self.lexer.advance();
        let inside = self.lexer.name()?;
        let name = self.normalized_name(inside)?;
        if !self.lexer.take(b']') {
            return Err(expected_name(self.lexer.position()));
        }
        Ok(f64::from(u8::from(self.scope.named(&name).is_some())))
    }

    /// The value of a parameter; the next character is `#`.
    #[inline]
    fn parameter(&mut self) -> Result<f64, Fault> {
        let start = self.lexer.position();
        match self.target()? {
            Target::Numbered(index) => Ok(self.scope.numbered(index)),
            Target::Named(inside) => {
                let name = self.normalized_name(inside)?;
                self.scope.named(&name).ok_or_else(|| {
                    for (prefix, what) in [("_ini[", "an INI file"), ("_hal[", "HAL pins")] {
                        if name.as_str().starts_with(prefix) {
                            let message = format!(
                                "#<{}> reads {what} of LinuxCNC, which does not exist here",
                                name.as_str()
                            );
                            let span = Span::new(start, self.lexer.position());
                            return Fault::new(Code::UndefinedParameter, span, message).help(
                                "write the number itself, or store it in a parameter: #<_limit> = 400 once, \
                                 then #<_limit>",
                            );
                        }
                    }
                    let message = format!("#<{}> has not been set", name.as_str());
                    let span = Span::new(start, self.lexer.position());
                    Fault::new(Code::UndefinedParameter, span, message).help(
                        if name.as_str().starts_with('_') {
                            "write #<_name> = value before it is read"
                        } else {
                            "names that do not start with _ are local to the subroutine in which they are set"
                        },
                    )
                })
            }
        }
    }

    /// The parameter that is meant; the next character is `#`.
    #[inline]
    pub(crate) fn target(&mut self) -> Result<Target, Fault> {
        if let Some(index) = self.lexer.index() {
            return Ok(Target::Numbered(index));
        }
        self.computed_target()
    }

    fn computed_target(&mut self) -> Result<Target, Fault> {
        let start = self.lexer.position();
        self.lexer.advance();
        if self.lexer.peek() == Some(b'<') {
            return Ok(Target::Named(self.lexer.name()?));
        }
        self.nest(start)?;
        let value = self.required("after #")?;
        self.depth -= 1;
        let rounded = value.round();
        let span = Span::new(start, self.lexer.position());
        if (value - rounded).abs() > 1e-4 {
            let message = format!("#{}: the number of a parameter must be an integer", plain(value));
            return Err(Fault::new(Code::NotInteger, span, message));
        }
        if !(1.0..NUMBERED as f64).contains(&rounded) {
            let message = format!(
                "#{}: parameters have numbers from 1 to {}",
                plain(rounded),
                NUMBERED - 1
            );
            return Err(Fault::new(Code::Parameter, span, message));
        }
        Ok(Target::Numbered(rounded as usize))
    }

    /// The normalised name at a position.
    pub(crate) fn normalized_name(&self, inside: Span) -> Result<NormalizedName, Fault> {
        let text = &self.lexer.text()[inside.start as usize..inside.end as usize];
        NormalizedName::new(text).ok_or_else(|| {
            Fault::new(Code::BadName, inside, "this is not a valid name")
                .help("a name has 1 to 100 ASCII characters")
        })
    }

    fn nest(&mut self, start: usize) -> Result<(), Fault> {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            let message = format!("nested deeper than {MAX_DEPTH}");
            return Err(Fault::new(Code::NestingTooDeep, Span::at(start), message)
                .help("store a part of the expression in a parameter"));
        }
        Ok(())
    }
}

fn apply(operator: Operator, left: f64, right: f64, span: Span) -> Result<f64, Fault> {
    let flag = |yes: bool| if yes { 1.0 } else { 0.0 };
    let difference = left - right;
    let value = match operator {
        Operator::And => flag(left != 0.0 && right != 0.0),
        Operator::Or => flag(left != 0.0 || right != 0.0),
        Operator::Xor => flag((left != 0.0) != (right != 0.0)),
        Operator::Equal => flag(difference.abs() < EQUAL_TOLERANCE),
        Operator::NotEqual => flag(difference.abs() >= EQUAL_TOLERANCE),
        Operator::Greater => flag(left > right),
        Operator::GreaterEqual => flag(left >= right),
        Operator::Less => flag(left < right),
        Operator::LessEqual => flag(left <= right),
        Operator::Add => left + right,
        Operator::Subtract => left - right,
        Operator::Multiply => left * right,
        Operator::Divide if right == 0.0 => {
            return Err(Fault::new(Code::Arithmetic, span, format!("{left} divided by 0")));
        }
        Operator::Divide => left / right,
        Operator::Modulo if right == 0.0 => {
            return Err(Fault::new(Code::Arithmetic, span, format!("{left} MOD 0")));
        }
        Operator::Modulo => {
            // Never negative, for any signs.
            let remainder = left % right;
            if remainder < 0.0 {
                remainder + right.abs()
            } else {
                remainder
            }
        }
        Operator::Power if left < 0.0 && right.floor() != right => {
            let message = format!("{left} ** {right}: a negative number to a power that is not an integer");
            return Err(Fault::new(Code::Arithmetic, span, message));
        }
        Operator::Power => libm::pow(left, right),
    };
    finite(value, span)
}

fn finite(value: f64, span: Span) -> Result<f64, Fault> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(Fault::new(
            Code::Arithmetic,
            span,
            "the result is not a finite number",
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::scope::tests::with_scope;

    fn of(text: &str) -> Result<f64, Code> {
        with_scope(|scope| {
            let mut lexer = Lexer::new(text.as_bytes());
            let mut evaluator = Evaluator::new(&mut lexer, scope);
            let value = evaluator.required("here").map_err(|fault| fault.code)?;
            assert_eq!(lexer.peek(), None, "{text:?} is not read to its end");
            Ok(value)
        })
    }

    #[test]
    fn operators_bind_as_in_linuxcnc() {
        // Values computed by hand; surprising ones were confirmed with LinuxCNC 2.9.
        for (text, expected) in [
            ("[1 + 2 * 3]", 7.0),
            ("[2 ** 3 ** 2]", 64.0),
            ("[-2 ** 2]", 4.0),
            ("[2 * -3]", -6.0),
            ("[10 / 4 * 2]", 5.0),
            ("[10 - 4 - 3]", 3.0),
            ("[5 mod -3]", 2.0),
            ("[-5 MOD 3]", 1.0),
            ("[1 OR 0 AND 0]", 0.0),
            ("[1 + 2 EQ 3 AND 1]", 1.0),
            ("[1 X O R 1]", 0.0),
            ("[3 GT 2]", 1.0),
            ("[2.0000004 EQ 2]", 1.0),
            ("[2.0000004 NE 2]", 0.0),
            ("[2 GE 2.0000004]", 0.0),
            ("[2 LT 2.0000004]", 1.0),
            ("[2 LE 1]", 0.0),
            ("--1", 1.0),
            ("+-1", -1.0),
            ("-[1]", -1.0),
            ("- abs[-3]", -3.0),
            ("[[1]]", 1.0),
        ] {
            assert_eq!(of(text), Ok(expected), "{text}");
        }
    }

    #[test]
    fn functions_use_degrees_and_round_as_in_linuxcnc() {
        for (text, expected) in [
            ("sin[30]", 0.5),
            ("COS[60]", 0.5),
            ("tan[45]", 1.0),
            ("asin[1]", 90.0),
            ("acos[0]", 90.0),
            ("atan[1]/[-1]", 135.0),
            ("ATAN[-1]/[-1]", -135.0),
            ("fix[-2.5]", -3.0),
            ("fup[-2.5]", -2.0),
            ("round[-2.5]", -3.0),
            ("round[2.5]", 3.0),
            ("sqrt[2]", 2.0_f64.sqrt()),
            ("ln[exp[2]]", 2.0),
            ("exists[#<nothing>]", 0.0),
            ("exists[#<_line>]", 1.0),
            ("exists[#5]", 1.0),
            ("exists[#99999]", 0.0),
        ] {
            let found = of(text).unwrap();
            assert!((found - expected).abs() < 1e-14, "{text}: {found}");
        }
    }

    #[test]
    fn invalid_expressions_are_rejected() {
        for (text, expected) in [
            ("[1/0]", Code::Arithmetic),
            ("[1 MOD 0]", Code::Arithmetic),
            ("sqrt[-1]", Code::Arithmetic),
            ("ln[0]", Code::Arithmetic),
            ("asin[1.1]", Code::Arithmetic),
            ("acos[-1.1]", Code::Arithmetic),
            ("[-2 ** 0.5]", Code::Arithmetic),
            ("[0 ** -1]", Code::Arithmetic),
            ("exp[1000]", Code::Arithmetic),
            ("[1 + ]", Code::Expression),
            ("[1", Code::Expression),
            ("[]", Code::Expression),
            ("[1 [2]]", Code::Expression),
            ("[1 foo 2]", Code::Expression),
            ("foo[1]", Code::Expression),
            ("atan[1]", Code::Expression),
            ("atan[1]/2", Code::Expression),
            ("exists[1]", Code::Expression),
            ("#0", Code::Parameter),
            ("#5602", Code::Parameter),
            ("#-1", Code::Parameter),
            ("#1.5", Code::NotInteger),
            ("#<", Code::BadName),
            ("#<>", Code::BadName),
            ("#<nothing>", Code::UndefinedParameter),
            (
                &format!("{}1{}", "[".repeat(65), "]".repeat(65)),
                Code::NestingTooDeep,
            ),
            (&"#".repeat(9000), Code::NestingTooDeep),
            (&"-".repeat(9000), Code::NestingTooDeep),
        ] {
            assert_eq!(of(text), Err(expected), "{text}");
        }
    }
}
