// This file is written by the test of the generated types.

/** Why the core does not do what it is asked for. */
export type RejectionNumber = 900 | 901 | 902 | 903 | 904 | 910 | 911 | 912 | 913 | 914 | 915 | 916 | 917 | 918 | 919 | 920 | 921 | 922 | 923 | 924 | 925 | 926 | 927 | 928 | 929 | 930 | 931 | 932 | 933 | 934;
