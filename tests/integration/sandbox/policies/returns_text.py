# expect: bad_action_type
# where: episode
class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return "up"
