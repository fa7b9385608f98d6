"""Gymnasium environments: FlexibleArm-v0, TwoLinkFlexArm-v0, MultiLinkFlexArm-v0, SpatialFlexArm-v0."""
