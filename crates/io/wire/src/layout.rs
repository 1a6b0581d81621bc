//! The memory layout of payloads, defined once: the macro generates the Rust struct and the table from which the C
//! header and the Python module are generated.

/// Number of axes in every payload, in the order X Y Z A B C U V W.
pub const AXES: usize = 9;

/// The element type of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    /// An unsigned byte, part of a text field.
    U8,
    /// An unsigned 32-bit integer.
    U32,
    /// An unsigned 64-bit integer.
    U64,
    /// A signed 64-bit integer.
    I64,
    /// An IEEE 754 binary32 number.
    F32,
    /// An IEEE 754 binary64 number.
    F64,
}

impl Scalar {
    /// The size of one element in bytes.
    #[must_use]
    pub const fn size_bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// The type's name in C.
    #[must_use]
    pub const fn c_name(self) -> &'static str {
        match self {
            Self::U8 => "uint8_t",
            Self::U32 => "uint32_t",
            Self::U64 => "uint64_t",
            Self::I64 => "int64_t",
            Self::F32 => "float",
            Self::F64 => "double",
        }
    }

    /// The type's name in Python's `ctypes`.
    #[must_use]
    pub const fn ctypes_name(self) -> &'static str {
        match self {
            Self::U8 => "c_uint8",
            Self::U32 => "c_uint32",
            Self::U64 => "c_uint64",
            Self::I64 => "c_int64",
            Self::F32 => "c_float",
            Self::F64 => "c_double",
        }
    }
}

/// One field of a payload.
#[derive(Clone, Copy, Debug)]
pub struct FieldLayout {
    /// The field's name, the same in every language.
    pub name: &'static str,
    /// Its meaning and unit.
    pub doc: &'static str,
    /// The element type.
    pub scalar: Scalar,
    /// The number of elements of an array, or none for a single value.
    pub count: Option<usize>,
    /// Bytes from the start of the payload.
    pub offset_bytes: usize,
}

impl FieldLayout {
    /// The size of the whole field in bytes.
    #[must_use]
    pub const fn size_bytes(&self) -> usize {
        match self.count {
            Some(count) => count * self.scalar.size_bytes(),
            None => self.scalar.size_bytes(),
        }
    }
}

/// One payload: its name on the bus, size and fields in order, without gaps.
#[derive(Clone, Copy, Debug)]
pub struct StructLayout {
    /// The struct's name in Rust and Python.
    pub name: &'static str,
    /// The type name by which iceoryx2 distinguishes payloads.
    pub type_name: &'static str,
    /// The purpose of the payload.
    pub doc: &'static [&'static str],
    /// The size in bytes, a multiple of 8.
    pub size_bytes: usize,
    /// The fields in memory order.
    pub fields: &'static [FieldLayout],
}

impl StructLayout {
    /// Whether the fields follow each other without a gap, up to the end.
    #[must_use]
    pub const fn is_gapless(&self) -> bool {
        let mut end = 0;
        let mut i = 0;
        while i < self.fields.len() {
            if self.fields[i].offset_bytes != end {
                return false;
            }
            end += self.fields[i].size_bytes();
            i += 1;
        }
        end == self.size_bytes
    }
}

/// A type that a payload may contain: every bit pattern is a valid value.
pub(crate) trait Field {
    /// The element type.
    const SCALAR: Scalar;
    /// The number of elements of an array.
    const COUNT: Option<usize>;
    /// All bits zero.
    const ZERO: Self;
}

macro_rules! field {
    ($type:ty, $scalar:ident, $zero:literal) => {
        impl Field for $type {
            const SCALAR: Scalar = Scalar::$scalar;
            const COUNT: Option<usize> = None;
            const ZERO: Self = $zero;
        }
        impl<const N: usize> Field for [$type; N] {
            const SCALAR: Scalar = Scalar::$scalar;
            const COUNT: Option<usize> = Some(N);
            const ZERO: Self = [$zero; N];
        }
    };
}
field!(u8, U8, 0);
field!(u32, U32, 0);
field!(u64, U64, 0);
field!(i64, I64, 0);
field!(f32, F32, 0.0);
field!(f64, F64, 0.0);

/// A message on the bus.
pub trait Payload: Copy + Sized {
    /// Its layout, for generators and tests.
    const LAYOUT: StructLayout;

    /// The version that its sender was built for.
    fn interface_version(&self) -> u32;

    /// The size that its sender believes the payload has, in bytes.
    fn struct_size(&self) -> u32;

    /// Whether version and size are those of this build. Receivers drop other messages.
    fn is_compatible(&self) -> bool {
        self.interface_version() == crate::INTERFACE_VERSION
            && self.struct_size() as usize == Self::LAYOUT.size_bytes
    }
}

/// Defines a payload: fields in memory order, after the common header of version and size.
macro_rules! payload {
    (
        $(#[doc = $struct_doc:literal])*
        pub struct $name:ident = $type_name:literal {
            $(#[doc = $doc:literal] $field:ident: $type:ty,)*
        }
    ) => {
        $(#[doc = $struct_doc])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name {
            /// Version of the bus contract that the sender was built for; receivers reject another version.
            pub interface_version: u32,
            /// Size of this payload in bytes.
            pub struct_size: u32,
            $(#[doc = $doc] pub $field: $type,)*
        }

        impl Default for $name {
            /// All zero except the header.
            fn default() -> Self {
                Self {
                    interface_version: crate::INTERFACE_VERSION,
                    struct_size: size_of::<Self>() as u32,
                    $($field: <$type as crate::layout::Field>::ZERO,)*
                }
            }
        }

        impl crate::layout::Payload for $name {
            const LAYOUT: crate::layout::StructLayout = crate::layout::StructLayout {
                name: stringify!($name),
                type_name: $type_name,
                doc: &[$($struct_doc,)*],
                size_bytes: size_of::<$name>(),
                fields: &[
                    crate::layout::FieldLayout {
                        name: "interface_version",
                        doc: " Version of the bus contract that the sender was built for; receivers reject \
                         another version.",
                        scalar: crate::layout::Scalar::U32,
                        count: None,
                        offset_bytes: core::mem::offset_of!($name, interface_version),
                    },
                    crate::layout::FieldLayout {
                        name: "struct_size",
                        doc: " Size of this payload in bytes.",
                        scalar: crate::layout::Scalar::U32,
                        count: None,
                        offset_bytes: core::mem::offset_of!($name, struct_size),
                    },
                    $(crate::layout::FieldLayout {
                        name: stringify!($field),
                        doc: $doc,
                        scalar: <$type as crate::layout::Field>::SCALAR,
                        count: <$type as crate::layout::Field>::COUNT,
                        offset_bytes: core::mem::offset_of!($name, $field),
                    },)*
                ],
            };

            fn interface_version(&self) -> u32 {
                self.interface_version
            }

            fn struct_size(&self) -> u32 {
                self.struct_size
            }
        }

        // SAFETY: repr(C), without gaps (asserted below); `Field` admits only integers and floats and arrays
        // of them.
        #[cfg(feature = "zero-copy")]
        unsafe impl iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend for $name {
            unsafe fn type_name() -> &'static str {
                $type_name
            }
        }

        // A gap would expose previous memory contents to other processes.
        const _: () = assert!(<$name as crate::layout::Payload>::LAYOUT.is_gapless());
        const _: () = assert!(align_of::<$name>() == 8 && size_of::<$name>() % 8 == 0);
    };
}
pub(crate) use payload;
