//! Rejected lines of other dialects that are recognized by their characters.

use std::borrow::Cow;

use crate::Code;
use crate::diagnostics::diagnostic::Fault;
use crate::diagnostics::foreign_line::replacement;

/// A rejected line, and its error.
pub(super) struct ForeignText<'a> {
    /// Without leading spaces.
    start: &'a str,
    /// Up to the first comment.
    code: &'a str,
    /// `code` without spaces.
    compact: String,
    upper: String,
    fault: &'a Fault,
}

impl<'a> ForeignText<'a> {
    pub(super) fn new(line: &'a str, fault: &'a Fault) -> Self {
        let code = line.split(['(', ';']).next().unwrap_or_default();
        let compact: String = code
            .chars()
            .filter(|character| !character.is_whitespace())
            .collect();
        Self {
            start: line.trim_start_matches([' ', '\t']),
            code,
            upper: compact.to_ascii_uppercase(),
            compact,
            fault,
        }
    }

    /// A better error; `None` if the line is not recognized.
    pub(super) fn explain(&self) -> Option<Fault> {
        self.stray_percent()
            .or_else(|| self.program_name())
            .or_else(|| self.control_character())
            .or_else(|| self.number_with_comma())
            .or_else(|| self.grbl())
            .or_else(|| self.program_number())
            .or_else(|| self.block_delete_level())
            .or_else(|| self.word_after_comma())
            .or_else(|| self.nested_name())
            .or_else(|| self.macro_assignment())
            .or_else(|| self.siemens())
    }

    fn replacement(&self, message: impl Into<String>, help: impl Into<Cow<'static, str>>) -> Fault {
        replacement(self.fault, message, help)
    }

    fn stray_percent(&self) -> Option<Fault> {
        if self.fault.code != Code::StrayPercent {
            return None;
        }
        if self.compact == "%" {
            return Some(self.replacement(
                "'%' in the middle of a program",
                "move it to the first line, before any comment, or delete it; the program ends at M2, M30 or a \
                 second %",
            ));
        }
        self.start.starts_with('%').then(|| {
            self.replacement(
                "text after %, which must be alone on its line",
                "write % alone on the first line and on the last, and the text after it on the next line; a \
                 name can be a comment: (PART 1)",
            )
        })
    }

    /// `$NAME%`.
    fn program_name(&self) -> Option<Fault> {
        (self.upper.starts_with('$') && self.upper.ends_with('%')).then(|| {
            self.replacement(
                format!("{} is the name of a program in another dialect", self.compact),
                "delete the line, or write it as a comment: (NAME)",
            )
        })
    }

    fn control_character(&self) -> Option<Fault> {
        let can_be = matches!(
            self.fault.code,
            Code::UnexpectedCharacter | Code::BadNumber | Code::NumberMissing
        );
        let mut characters = self.code.chars().filter(|_| can_be);
        let found =
            characters.find(|character| character.is_ascii_control() && !character.is_ascii_whitespace())?;
        Some(self.replacement(
            format!(
                "a control character (0x{:02X}) that is not part of a program",
                u32::from(found)
            ),
            "delete it: it is left over from a transmission, such as STX or the end of a file (0x1A)",
        ))
    }

    fn number_with_comma(&self) -> Option<Fault> {
        if self.fault.code != Code::UnexpectedCharacter {
            return None;
        }
        let number = decimal_comma(&self.compact)?;
        Some(self.replacement(
            format!("{number}: numbers have a decimal point"),
            format!("write {}", number.replace(',', ".")),
        ))
    }

    /// `$H`, `$J=...`, `$100=...`.
    fn grbl(&self) -> Option<Fault> {
        let upper = &self.upper;
        if !upper.starts_with('$') || matches!(self.fault.code, Code::SpindleSelection | Code::UnusedWord) {
            return None;
        }
        let word: String = upper.chars().take_while(|character| *character != '=').collect();
        let help = if upper.starts_with("$H") {
            "delete the line and home the machine before the program (evolvent ctl home)"
        } else if upper.starts_with("$J") {
            "delete the line, or write the move as G91 G1 X.. F.."
        } else {
            "delete the line; settings are in the machine file"
        };
        Some(self.replacement(
            format!("{word} is a command of Grbl, not a line of a program"),
            help,
        ))
    }

    /// `:1234`.
    fn program_number(&self) -> Option<Fault> {
        let rest = self.upper.strip_prefix(':')?;
        let number: String = rest.chars().take_while(char::is_ascii_digit).collect();
        if number.is_empty() {
            return None;
        }
        Some(self.replacement(
            format!(":{number} is a program number in another dialect"),
            format!(
                "delete it, or write it as a comment: (O{number}); a subroutine is O{number} sub ... \
                 O{number} endsub"
            ),
        ))
    }

    /// `/2 ...`.
    fn block_delete_level(&self) -> Option<Fault> {
        let rest = self.upper.strip_prefix('/')?;
        rest.starts_with(|digit: char| digit.is_ascii_digit()).then(|| {
            self.replacement(
                "/ with a number: block delete has one switch here, and no levels",
                "write / without a number",
            )
        })
    }

    /// `,R`, `,C` and `,A` of a straight move.
    fn word_after_comma(&self) -> Option<Fault> {
        let words = [
            (
                ",R",
                "corner rounding (,R)",
                "write the rounding as an arc: G2 or G3 with R",
            ),
            (",C", "a chamfer (,C)", "write the chamfer as a line: G1 X.. Y.."),
            (",A", "a line by its angle (,A)", "write the end point: X.. Y.."),
        ];
        let can_be = self.fault.code == Code::UnexpectedCharacter;
        let mut words = words.into_iter().filter(|_| can_be);
        let (_, meaning, help) = words.find(|(mark, ..)| self.upper.contains(mark))?;
        Some(self.replacement(format!("{meaning} is not part of this dialect"), help))
    }

    /// `#<a|#<b>>`.
    fn nested_name(&self) -> Option<Fault> {
        self.compact.contains("|#<").then(|| {
            self.replacement(
                "the name of a parameter inside another name is not part of this dialect",
                "write numbers: #[100 + #<b>] is one parameter of a list",
            )
        })
    }

    /// An expression without brackets after `#1 =`.
    fn macro_assignment(&self) -> Option<Fault> {
        let is_incomplete = matches!(
            self.fault.code,
            Code::BadNumber
                | Code::LetterMissing
                | Code::UnexpectedCharacter
                | Code::MisplacedBlockDelete
                | Code::NumberMissing
        );
        if !is_incomplete || !self.compact.starts_with(['#', 'N', 'n', '/']) {
            return None;
        }
        let start = self.code.find('#')?;
        let (target, expression) = self.code[start..].split_once('=')?;
        let expression = expression.trim();
        let mut depth = 0_i32;
        let has_operator = expression.char_indices().any(|(index, character)| {
            depth += i32::from(character == '[') - i32::from(character == ']');
            depth == 0 && index > 0 && matches!(character, '+' | '-' | '*' | '/')
        });
        let target = target.trim();
        (has_operator && !expression.contains('=')).then(|| {
            self.replacement(
                "an expression without brackets",
                format!("write {target} = [{expression}]"),
            )
        })
    }

    /// `X=10`, `CR=5`, `CYCLE81(...)`.
    fn siemens(&self) -> Option<Fault> {
        let upper = &self.upper;
        if upper.starts_with("CYCLE") || upper.starts_with("MCALL") {
            let help = "write a cycle of this dialect: G81 X.. Y.. Z.. R.. drills, G83 with Q pecks";
            return Some(self.replacement(
                "cycles by name (CYCLE81, MCALL) are not part of this dialect",
                help,
            ));
        }
        let index = upper.find('=').filter(|_| !upper.contains('#'))?;
        let reversed: Vec<char> = upper[..index]
            .chars()
            .rev()
            .take_while(char::is_ascii_alphabetic)
            .collect();
        let name: String = reversed.iter().rev().collect();
        match &name[..] {
            "" => None,
            "CR" => Some(self.replacement(
                "CR=, the radius of an arc, is R in this dialect",
                "write R without =, as in G2 X1 Y1 R5",
            )),
            name if name.len() == 1 || name.ends_with(['X', 'Y', 'Z', 'I', 'J', 'K']) => {
                let letter = &name[name.len() - 1..];
                let help = format!(
                    "write {letter}10 in place of {letter}=10, and {letter}#1 for the value of a parameter"
                );
                Some(self.replacement("words with = are not part of this dialect", help))
            }
            _ => None,
        }
    }
}

/// The first number with a comma in place of the decimal point, with the letter before it.
fn decimal_comma(compact: &str) -> Option<&str> {
    let bytes = compact.as_bytes();
    let is_digit = |index: usize| bytes.get(index).is_some_and(u8::is_ascii_digit);
    // Functions have two values in brackets on other controls.
    let before = compact.find(['[', '(']).unwrap_or(bytes.len());
    let comma =
        (1..before).find(|index| bytes[*index] == b',' && is_digit(index - 1) && is_digit(index + 1))?;
    let is_in_number = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'+' | b'-');
    let digits = bytes[..comma]
        .iter()
        .rev()
        .take_while(|byte| is_in_number(byte))
        .count();
    let has_letter = comma > digits && bytes[comma - digits - 1].is_ascii_alphabetic();
    if !has_letter {
        return None;
    }
    let fraction = bytes[comma + 1..]
        .iter()
        .take_while(|byte| byte.is_ascii_digit())
        .count();
    compact.get(comma - digits - 1..comma + 1 + fraction)
}
