//! Angles that G90 commands on unlimited rotary axes.

use evolvent_path::{AXES, Axes, AxisLetter, TURN_DEG, turn_onward, turn_shorter};

use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;
use crate::{Code, RotaryDirection};

impl Executor<'_> {
    /// Replaces the angles in an absolute target by the coordinates at which the axes reach them.
    pub(crate) fn unwrap_angles(&self, from: &Axes, target: &mut Axes) -> Result<(), Fault> {
        for index in 0..AXES {
            let (Some(direction), Some(word)) =
                (self.settings.features.unlimited[index], self.line.axis(index))
            else {
                continue;
            };
            target[index] = match direction {
                RotaryDirection::Shorter => turn_shorter(from[index], target[index]),
                RotaryDirection::Sign if word.abs() >= TURN_DEG => {
                    let name = AxisLetter::ALL[index].letter();
                    let message = format!("{name}{word}: an angle of an unlimited axis is below 360 degrees");
                    let span = self.line.span(name as u8);
                    return Err(Fault::new(Code::OutOfRange, span, message).help(
                        "write the angle, with a minus to turn in the negative direction; G91 turns farther",
                    ));
                }
                RotaryDirection::Sign => {
                    // The sign belongs to the word, not to the target with its offsets.
                    let angle_deg = target[index] - word + word.abs();
                    turn_onward(from[index], angle_deg, word.is_sign_negative())
                }
            };
        }
        Ok(())
    }
}
