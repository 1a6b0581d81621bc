//! Gantries of a network: two drives of one axis.

use evolvent_config::{ConfigDocument, ConfigError};

use super::{NetworkAxis, NetworkDevice};

/// Checks that the second drive of each gantry has a first one, which finds its zero in the same way.
pub(super) fn check_gantries(
    sheet: &ConfigDocument<'_>,
    devices: &[NetworkDevice],
) -> Result<(), ConfigError> {
    for (i, device) in devices.iter().enumerate() {
        let Some(second) = device.axis.filter(|axis| axis.gantry.is_some()) else {
            continue;
        };
        let mut others = devices.iter().filter_map(|other| other.axis);
        let first = others.find(|other| other.axis == second.axis && other.gantry.is_none());
        let Some(first) = first else {
            return Err(sheet.error(
                &format!("device[{i}].axis.gantry"),
                "no other device drives this axis".to_owned(),
                "give the first drive of the gantry the same letter, without [device.axis.gantry]",
            ));
        };
        check_pair(sheet, &format!("device[{i}].axis"), &first, &second)?;
    }
    Ok(())
}

/// Checks the drives of one gantry; `key` is the axis of the second.
fn check_pair(
    sheet: &ConfigDocument<'_>,
    key: &str,
    first: &NetworkAxis,
    second: &NetworkAxis,
) -> Result<(), ConfigError> {
    // Otherwise only one of the drives would know its position.
    let alike = first.absolute == second.absolute
        && first.homing.map(|homing| homing.order) == second.homing.map(|homing| homing.order);
    if !alike {
        return Err(sheet.error(
            &format!("{key}.gantry"),
            "the drives of a gantry find their zero in different ways".to_owned(),
            "give both `absolute`, or both homing with the same `order`, or neither",
        ));
    }
    if first.home_switch_bit.is_some() != second.home_switch_bit.is_some() {
        let name = if second.home_switch_bit.is_some() {
            "home_switch_bit"
        } else {
            "gantry"
        };
        return Err(sheet.error(
            &format!("{key}.{name}"),
            "one drive of a gantry has a home switch, the other has none".to_owned(),
            "give each its own home_switch_bit, or remove it: then the beam is assumed to be square",
        ));
    }
    Ok(())
}
